"""How long a unit of the cameras' world is in metres, where something tells: a person, a marker, positions by GPS."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, MetricScale
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.capture_io import read_captured_image
from inpaint3d.stages.pose_estimation.config import Config, Distance, Marker
from inpaint3d.stages.pose_estimation.model import Model

Floats = NDArray[np.float64]
EARTH_RADIUS_M = 6_371_000.0
MOST_UNCERTAIN = 0.2  # of the scale itself: what GPS tells less well is unknown
LEAST_UNCERTAIN = 1e-4
LEAST_SPREAD_DEG = 0.1  # of the rays to a point: less is about a pixel, and they meet anywhere


class ParallelRaysError(BadInputError):
    """Rays that are too nearly parallel to meet."""


@dataclass(frozen=True)
class Sighting:
    """A pixel (captured size) of a view."""

    view: int
    xy: tuple[float, float]


def find_scale(
    capture: Artifact[Capture], frames: Sequence[CapturedFrame], model: Model, config: Config, ctx: Context
) -> MetricScale | None:
    """Metres per unit of the model's world; None where nothing tells. `frames`: those of the model's views.

    What a person says comes before markers, and these before GPS. BadInputError where what was asked for is not there.
    """
    if config.source_metres_per_unit is not None:
        return MetricScale(metres_per_unit=config.source_metres_per_unit, uncertainty=LEAST_UNCERTAIN,
                           evidence="the parameter source_metres_per_unit")  # fmt: skip
    if config.distance is not None:
        return _from_distance(config.distance, frames, model)
    if config.marker is not None:
        return _from_marker(config.marker, capture, frames, model, ctx)
    return _from_positions(frames, model, ctx)


def triangulate(model: Model, sightings: Sequence[Sighting]) -> tuple[Floats, float]:
    """The point [3] nearest to the rays of two or more sightings, and how far they miss it (root mean square).

    ParallelRaysError where it is anywhere along them.
    """
    normal, total, rays = np.zeros((3, 3)), np.zeros(3), []
    for s in sightings:
        pose, lens = model.world_from_cam[s.view], model.lenses[model.view_lens[s.view]]
        plane = np.asarray(lens.cam_from_img(np.array([s.xy], np.float64)))[0]
        ray = pose[:, :3] @ [*plane, 1.0]
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        normal, total = normal + across, total + across @ pose[:, 3]
        rays.append((across, pose[:, 3]))
    # The mean squared sine of the rays' angles to the direction that they share most.
    shared = max(float(np.linalg.eigvalsh(normal)[0]), 0.0) / len(sightings)
    if (spread := 2 * np.rad2deg(np.arcsin(np.sqrt(shared)))) < LEAST_SPREAD_DEG:
        raise ParallelRaysError(
            f"{len(sightings)} views see a point along rays that spread by {spread:.2g} degrees: how far it is cannot "
            "be told; choose views that stand further apart"
        )
    point = np.asarray(np.linalg.solve(normal, total), np.float64)
    miss = [np.sum((across @ (point - centre)) ** 2) for across, centre in rays]
    return point, float(np.sqrt(np.mean(miss)))


def _from_distance(distance: Distance, frames: Sequence[CapturedFrame], model: Model) -> MetricScale:
    view_of = {frame.name: view for view, frame in enumerate(frames)}
    if missing := [name for name in distance.pixels if name not in view_of]:
        raise BadInputError(f"distance.pixels names {missing[0]}, which is no view that could be placed")
    try:
        ends = [
            triangulate(model, [Sighting(view_of[name], pair[end]) for name, pair in distance.pixels.items()])
            for end in (0, 1)
        ]
    except ParallelRaysError as error:
        raise BadInputError(f"distance.pixels of {', '.join(distance.pixels)}: {error}") from error
    length, miss = float(np.linalg.norm(ends[0][0] - ends[1][0])), float(np.hypot(ends[0][1], ends[1][1]))
    if length <= miss:
        raise BadInputError(
            f"distance.pixels of {', '.join(distance.pixels)}: the two points lie {length:.3g} units apart, and their "
            f"rays miss them by {miss:.3g}; click on two points that are clearly apart, the same ones in every view"
        )
    return MetricScale(
        metres_per_unit=distance.metres / length, uncertainty=max(miss / length, LEAST_UNCERTAIN),
        evidence=f"two points {distance.metres:g} m apart, clicked in {len(distance.pixels)} views",
    )  # fmt: skip


def _from_marker(
    marker: Marker, capture: Artifact[Capture], frames: Sequence[CapturedFrame], model: Model, ctx: Context
) -> MetricScale:
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, marker.dictionary)))
    corners: dict[int, list[list[Sighting]]] = {}
    for view, frame in enumerate(frames):
        ctx.progress(view, len(frames), "looking for markers")
        grey = cv2.cvtColor(np.rint(read_captured_image(capture, frame) * 255).astype(np.uint8), cv2.COLOR_RGB2GRAY)
        found, numbers, _ = detector.detectMarkers(grey)
        for number, quad in zip(
            [] if numbers is None else np.ravel(numbers).astype(np.int64).tolist(), found, strict=True
        ):
            # OpenCV's pixels are whole at their centres.
            sighted = [Sighting(view, (float(x) + 0.5, float(y) + 0.5)) for x, y in quad.reshape(4, 2)]
            corners.setdefault(number, [[], [], [], []])
            for k in range(4):
                corners[number][k].append(sighted[k])
    sides: list[float] = []
    for quad in (c for c in corners.values() if len(c[0]) > 1):
        with suppress(ParallelRaysError):
            points = [triangulate(model, sightings)[0] for sightings in quad]
            sides += [float(np.linalg.norm(points[k] - points[k - 1])) for k in range(4)]
    if not sides:
        raise BadInputError(
            f"no marker of {marker.dictionary} is seen in two views that stand apart ({len(corners)} are seen); lay "
            "one down flat and photograph it from several sides, or leave pose-estimation.marker out"
        )
    mean, spread = float(np.mean(sides)), float(np.std(sides))
    return MetricScale(
        metres_per_unit=marker.side_m / mean, uncertainty=max(spread / mean / np.sqrt(len(sides)), LEAST_UNCERTAIN),
        evidence=f"{len(sides) // 4} markers of {marker.dictionary} with sides of {marker.side_m:g} m",
    )  # fmt: skip


def _from_positions(frames: Sequence[CapturedFrame], model: Model, ctx: Context) -> MetricScale | None:
    """The scale of the similarity between cameras and GPS positions (Umeyama, PAMI 1991, eq. 42)."""
    placed = [(view, f.exif.position) for view, f in enumerate(frames) if f.exif.position is not None]
    if len(placed) < 4:
        return None
    metres = _to_local_metres(np.array([position for _, position in placed]))
    centres = model.centres[[view for view, _ in placed]]
    metres, centres = metres - metres.mean(0), centres - centres.mean(0)
    u, singular, vt = np.linalg.svd(metres.T @ centres)
    singular[2] *= np.sign(np.linalg.det(u @ vt))
    extent = float(np.sum(centres**2))
    scale = float(singular.sum()) / extent
    turned = centres @ (u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt).T
    noise = float(np.sqrt(np.sum((metres - scale * turned) ** 2) / max(3 * len(placed) - 7, 1)))
    uncertainty = noise / (scale * np.sqrt(extent)) if scale > 0 else np.inf
    if uncertainty > MOST_UNCERTAIN:
        ctx.log(f"{len(placed)} GPS positions do not tell the scale: it is uncertain by {uncertainty:.0%}")
        return None
    return MetricScale(
        metres_per_unit=scale, uncertainty=max(uncertainty, LEAST_UNCERTAIN),
        evidence=f"GPS positions of {len(placed)} views, {noise:.1f} m off",
    )  # fmt: skip


def _to_local_metres(positions: Floats) -> Floats:
    """Latitude, longitude (degrees) and altitude (m) [n, 3] as metres east, north and up of their mean."""
    latitude, longitude, altitude = positions.T
    north = np.deg2rad(latitude - latitude.mean()) * EARTH_RADIUS_M
    # Beyond 180 degrees east begins the west.
    east = np.deg2rad((longitude - longitude[0] + 180) % 360 - 180) * EARTH_RADIUS_M
    return np.stack([east * np.cos(np.deg2rad(latitude.mean())), north, altitude], 1)
