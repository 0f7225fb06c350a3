"""A sparse model in plain arrays: lenses, poses, points and tracks, free of the library that found them."""

from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from numpy.typing import ArrayLike, NDArray

from inpaint3d.scene.geometry import Similarity

Floats = NDArray[np.float64]
DIGITS = 9


@dataclass(frozen=True, eq=False)
class Model:
    """Registered views and the points between them, in one world.

    lenses: by number, at the captured sizes; view_lens and world_from_cam ([n, 3, 4]) by view, in capture order.
    xyz [p, 3], error [p] (px at captured size); tracks in compressed rows as in `SparsePoints`, track_xy [t, 2] in
    captured pixels.
    """

    names: list[str]
    lenses: dict[int, pycolmap.Camera]
    view_lens: list[int]
    world_from_cam: Floats
    xyz: Floats
    error: Floats
    track_offsets: NDArray[np.int64]
    track_view: NDArray[np.int32]
    track_xy: Floats

    @property
    def centres(self) -> Floats:
        return self.world_from_cam[:, :, 3]

    @property
    def track_point(self) -> NDArray[np.int64]:
        return np.repeat(np.arange(len(self.xyz)), np.diff(self.track_offsets))

    def moved(self, similarity: Similarity) -> "Model":
        """The same model in another world."""
        poses = np.stack([similarity.pose(p) for p in self.world_from_cam])
        return replace(self, world_from_cam=poses, xyz=similarity.points(self.xyz))

    def residuals(self) -> Floats:
        """Reprojection error [t] of every observation, in captured pixels; inf behind a camera."""
        error = np.full(len(self.track_view), np.inf)
        points = self.xyz[self.track_point]
        for view, (lens, pose) in enumerate(zip(self.view_lens, self.world_from_cam, strict=True)):
            rows = np.flatnonzero(self.track_view == view)
            in_cam = (points[rows] - pose[:, 3]) @ pose[:, :3]
            front = in_cam[:, 2] > 0
            xy = np.asarray(self.lenses[lens].img_from_cam(np.ascontiguousarray(in_cam[front])))
            error[rows[front]] = np.linalg.norm(xy - self.track_xy[rows[front]], axis=1)
        return error


def from_reconstruction(found: pycolmap.Reconstruction, order: list[str]) -> Model:
    """Views in capture order (`order`: all names given), points in the order of their numbers.

    Poses and lens parameters are rounded: mapping repeats to 1e-14, and what follows should repeat bit for bit.
    """
    by_name = {found.image(i).name: found.image(i) for i in found.reg_image_ids()}
    images = [by_name[name] for name in order if name in by_name]
    view_of = {image.image_id: v for v, image in enumerate(images)}
    numbers = sorted(found.points3D)
    points = [found.points3D[i] for i in numbers]
    tracks = [sorted((view_of[e.image_id], e.point2D_idx) for e in p.track.elements) for p in points]
    views = [view for track in tracks for view, _ in track]
    xy = [images[view].points2D[k].xy for track in tracks for view, k in track]
    lenses = {i: pycolmap.Camera(c.todict()) for i, c in sorted(found.cameras.items())}
    for lens in lenses.values():
        lens.params = round_to_digits(lens.params, np.maximum(np.abs(lens.params), 1.0)).tolist()
    poses = [round_pose(image.cam_from_world().inverse().matrix()) for image in images]
    model = Model(
        names=[image.name for image in images],
        lenses=lenses,
        view_lens=[image.camera_id for image in images],
        world_from_cam=np.array(poses).reshape(-1, 3, 4),
        xyz=round_points([p.xyz for p in points]),
        error=np.zeros(len(points)),
        track_offsets=np.concatenate([[0], np.cumsum([len(t) for t in tracks])]).astype(np.int64),
        track_view=np.array(views, np.int32),
        track_xy=np.array(xy, np.float64).reshape(-1, 2),
    )
    return replace(model, error=mean_by_point(model, model.residuals()))


def round_to_digits(values: ArrayLike, magnitude: ArrayLike) -> Floats:
    """Values rounded to nine digits of a magnitude: one for each value, or that broadcasts.

    Numbers of different kinds have magnitudes of their own: a rotation that were rounded as the translation beside it
    would be worth nothing far from the origin, and one far point would round all others away.
    """
    step = 10.0 ** (np.ceil(np.log10(np.asarray(magnitude, np.float64))) - DIGITS)
    return np.round(np.asarray(values, np.float64) / step) * step


def round_points(xyz: ArrayLike) -> Floats:
    """Points [n, 3] of a world whose size is about 1, each as its own distance from the origin allows."""
    xyz = np.asarray(xyz, np.float64).reshape(-1, 3)
    return round_to_digits(xyz, np.maximum(np.abs(xyz).max(-1, keepdims=True, initial=0.0), 1.0))


def round_pose(pose: ArrayLike) -> Floats:
    """A pose [3, 4], its rotation and its translation apart."""
    pose = np.asarray(pose, np.float64)[:3]
    return np.concatenate([round_to_digits(pose[:, :3], 1.0), round_points(pose[:, 3]).T], 1)


def mean_by_point(model: Model, values: Floats) -> Floats:
    """Mean of observations' values [t] over each point's track, [p]."""
    lengths = np.diff(model.track_offsets)
    return np.bincount(model.track_point, values, len(lengths)) / np.maximum(lengths, 1)


def median_triangulation_angle(model: Model) -> float:
    """Median over points of the widest angle between two of its rays, degrees; 0 without points."""
    angles = []
    for point, (a, b) in enumerate(zip(model.track_offsets[:-1], model.track_offsets[1:], strict=True)):
        rays = model.xyz[point] - model.centres[model.track_view[a:b]]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        # Chords, not arc cosines: these lose small angles.
        chord = np.linalg.norm(rays[:, None] - rays[None], axis=-1).max()
        angles.append(2 * np.arcsin(min(chord / 2, 1.0)))
    return float(np.rad2deg(np.median(angles))) if angles else 0.0
