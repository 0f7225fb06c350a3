"""A tiny textured room with a ball on its floor, ray-cast in numpy: exact cameras, depth, masks and sparse points.

Stubs are built on it, and tests measure against it. The world is normalised as a posed capture's: z up, the ball's
middle at the origin, every camera within the unit ball. Light is even and falls from one side; nothing casts a
shadow, so that outside the ball's mask the picture without it is the same.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.capture_io import SparsePoints
from inpaint3d.scene.geometry import ray_sphere

Floats = NDArray[np.float64]

BALL_RADIUS = 0.2
ROOM_LOW = np.array([-1.3, -1.3, -BALL_RADIUS])
ROOM_HIGH = np.array([1.3, 1.3, 1.1])
_FLOOR = 2
_BALL = 6  # surfaces 0 to 5 are the room's: low x, y, z, then high x, y, z
_TINT = np.array(
    [
        [0.75, 0.55, 0.45], [0.50, 0.60, 0.70], [0.55, 0.45, 0.35], [0.60, 0.70, 0.50],
        [0.70, 0.65, 0.50], [0.80, 0.80, 0.78], [0.75, 0.25, 0.20],
    ]
)  # fmt: skip
_LIGHT = np.array([0.4, -0.5, 0.77])
_OCTAVES = ((0.5, 0.25), (0.17, 0.25), (0.06, 0.3), (0.025, 0.2))  # cell size in scene units, weight


@dataclass(frozen=True, eq=False)
class SyntheticScene:
    """n views: images and empty_images float32 [n, h, w, 3], depths (z) float64 [n, h, w], masks bool [n, h, w]."""

    names: list[str]
    cameras: list[Camera]
    images: NDArray[np.float32]
    depths: Floats
    object_masks: NDArray[np.bool_]
    empty_images: NDArray[np.float32]
    empty_depths: Floats
    points: SparsePoints


def synthetic_scene(
    views: int = 8,
    width: int = 48,
    height: int = 36,
    seed: int = 0,
    points: int = 400,
    arc_deg: float = 110.0,
    reach: float = 1.0,
) -> SyntheticScene:
    """Views along an arc round the ball; the same arguments give the same bytes.

    reach: how many times as far the walls and the ceiling stand, their textures as much coarser.
    """
    cameras = arc_cameras(views, width, height, arc_deg)
    rendered = [_render(c, seed, reach) for c in cameras]
    pictures, full, empty, masks = (np.stack(part) for part in zip(*rendered, strict=True))
    return SyntheticScene(
        names=[f"view_{i:03d}" for i in range(views)],
        cameras=cameras,
        images=pictures[:, 0],
        depths=full,
        object_masks=masks,
        empty_images=pictures[:, 1],
        empty_depths=empty,
        points=_sample_points(cameras, pictures[:, 0], points, seed, reach),
    )


def arc_cameras(views: int, width: int, height: int, arc_deg: float = 110.0) -> list[Camera]:
    """Cameras on an arc about the z axis, at wavering height and distance, that look at the origin."""
    angles = np.deg2rad(np.linspace(-arc_deg / 2, arc_deg / 2, views) - 90)
    focal = 0.95 * max(width, height)
    cameras = []
    for i, angle in enumerate(angles):
        distance = 0.85 + 0.05 * np.sin(2.1 * i)
        rise = 0.40 + 0.12 * np.cos(1.7 * i)
        flat = np.sqrt(distance**2 - rise**2)
        centre = np.array([flat * np.cos(angle), flat * np.sin(angle), rise])
        cameras.append(Camera(focal, focal, width / 2, height / 2, width, height, look_at(centre, (0.0, 0.0, 0.05))))
    return cameras


def cast(origins: Floats, directions: Floats, *, ball: bool, reach: float = 1.0) -> tuple[Floats, NDArray[np.int64]]:
    """Distance [*n] along unit rays from inside the room, and the surface they meet (`_BALL`, or the room's 0 to 5)."""
    with np.errstate(divide="ignore"):
        planes = np.where(directions < 0, ROOM_LOW * (reach, reach, 1.0), ROOM_HIGH * reach)
        t = np.where(directions == 0, np.inf, (planes - origins) / directions)
    axis = np.argmin(t, -1)
    distance = np.take_along_axis(t, axis[..., None], -1)[..., 0]
    surface = axis + 3 * (np.take_along_axis(directions, axis[..., None], -1)[..., 0] >= 0)
    if ball:
        near, _, _ = ray_sphere(origins, directions, np.zeros(3), BALL_RADIUS)
        surface = np.where(near < distance, _BALL, surface)
        distance = np.minimum(near, distance)
    return distance, surface


def shade(points: Floats, surface: NDArray[np.int64], seed: int, reach: float = 1.0) -> Floats:
    """Colour [*n, 3] in [0, 1] of surface points [*n, 3]."""
    axis = np.where(surface == _BALL, 0, surface % 3)
    flat = np.stack([np.where(axis == 0, points[..., 1], points[..., 0]),
                     np.where(axis == 2, points[..., 1], points[..., 2])], -1)  # fmt: skip
    turn = np.arctan2(points[..., 1], points[..., 0]) * BALL_RADIUS
    uv = np.where((surface == _BALL)[..., None], np.stack([turn, points[..., 2]], -1), flat)
    uv = uv / np.where((surface == _BALL) | (surface == _FLOOR), 1.0, reach)[..., None]
    texture = sum(weight * _evaluate_noise(uv / cell, surface, seed + k) for k, (cell, weight) in enumerate(_OCTAVES))
    normal = np.where(surface < 3, 1.0, -1.0)[..., None] * np.eye(3)[axis]
    normal = np.where((surface == _BALL)[..., None], points / BALL_RADIUS, normal)
    light = 0.75 + 0.25 * (normal @ _LIGHT)
    return np.clip(_TINT[surface] * light[..., None] + 1.1 * (texture - 0.5), 0.0, 1.0)


def _render(camera: Camera, seed: int, reach: float) -> tuple[NDArray[np.float32], Floats, Floats, NDArray[np.bool_]]:
    """Pictures [2, h, w, 3] with and without the ball (means of 2x2 samples), depths [2, h, w] and mask [h, w]."""
    xy = camera.pixel_centres()
    colour = np.zeros((2, camera.height, camera.width, 3))
    for dx, dy in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
        origins, directions = camera.rays(xy + np.array([dx, dy]))
        distance, surface = cast(origins, directions, ball=False, reach=reach)
        room = shade(origins + distance[..., None] * directions, surface, seed, reach)
        distance, surface = cast(origins, directions, ball=True, reach=reach)
        on_ball = surface == _BALL
        points = origins[on_ball] + distance[on_ball, None] * directions[on_ball]
        colour[1] += room / 4
        room[on_ball] = shade(points, surface[on_ball], seed)
        colour[0] += room / 4
    origins, directions = camera.rays()
    (full, surface), (empty, _) = (cast(origins, directions, ball=b, reach=reach) for b in (True, False))
    along = directions @ camera.forward
    return colour.astype(np.float32), full * along, empty * along, surface == _BALL


def _evaluate_noise(uv: Floats, surface: NDArray[np.int64], seed: int) -> Floats:
    """Random colours at whole coordinates, smoothly in between; [*n, 3] in [0, 1]. Repeats every 256 cells."""
    lattice = np.random.default_rng(seed).random((256, 256, 3))
    cell = np.floor(uv).astype(np.int64)
    f = uv - cell
    f = f * f * (3 - 2 * f)
    # Each surface reads its own part of the lattice.
    column, row = (cell[..., 0] + 37 * surface) & 255, (cell[..., 1] + 91 * surface) & 255
    u, v = f[..., :1], f[..., 1:]
    low = lattice[row, column] * (1 - u) + lattice[row, (column + 1) & 255] * u
    row = (row + 1) & 255
    high = lattice[row, column] * (1 - u) + lattice[row, (column + 1) & 255] * u
    return low * (1 - v) + high * v


def _sample_points(
    cameras: list[Camera], images: NDArray[np.float32], count: int, seed: int, reach: float
) -> SparsePoints:
    """Surface points behind random pixels that at least three views (or all, if fewer) see, with exact tracks."""
    rng = np.random.default_rng(seed)
    frame = rng.integers(0, len(cameras), 4 * count)
    size = (cameras[0].width, cameras[0].height)
    pixels = rng.random((4 * count, 2)) * size
    rays = [cameras[k].rays(p) for k, p in zip(frame, pixels, strict=True)]
    origins, directions = np.stack([r[0] for r in rays]), np.stack([r[1] for r in rays])
    xyz = origins + cast(origins, directions, ball=True, reach=reach)[0][:, None] * directions
    xy, seen = zip(*(_sees(c, xyz, reach) for c in cameras), strict=True)
    seen = np.stack(seen)
    kept = np.flatnonzero(seen.sum(0) >= min(3, len(cameras)))[:count]
    point, track_frame = np.nonzero(seen[:, kept].T)
    rgb = [images[frame[i], int(pixels[i, 1]), int(pixels[i, 0])] for i in kept]
    return SparsePoints(
        xyz=xyz[kept].astype(np.float32),
        rgb=np.rint(np.array(rgb).reshape(-1, 3) * 255).astype(np.uint8),
        error=np.zeros(len(kept), np.float32),
        track_offsets=np.concatenate([[0], np.cumsum(np.bincount(point, minlength=len(kept)))]).astype(np.int64),
        track_frame=track_frame.astype(np.int32),
        track_xy=np.stack(xy)[track_frame, kept[point]].astype(np.float32),
    )


def _sees(camera: Camera, xyz: Floats, reach: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Where points fall in a view, and whether nothing stands in front of them."""
    xy, z = camera.project(xyz)
    away = xyz - camera.centre
    distance = np.linalg.norm(away, axis=-1)
    met, _ = cast(np.broadcast_to(camera.centre, xyz.shape), away / distance[:, None], ball=True, reach=reach)
    return xy, camera.inside(xy, z) & (np.abs(met - distance) < 1e-6)
