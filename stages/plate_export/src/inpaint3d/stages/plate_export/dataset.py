"""The plates' cameras as other tools read them: COLMAP's model, binary and text, and nerfstudio's transforms.json."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import PosedCapture
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.capture_io import SparsePoints, load_points
from inpaint3d.scene.geometry import Similarity
from inpaint3d.scene.masked_views import find_unmasked
from inpaint3d.stages.plate_export.lens import Floats
from inpaint3d.stages.plate_export.views import PlateView

# OpenCV's camera axes (y down, z forward) as OpenGL's (y up, z backward), which nerfstudio has.
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def write_dataset(
    folder: Path, posed: Artifact[PosedCapture], views: Sequence[PlateView], pictures: Mapping[str, str]
) -> list[str]:
    """Write `sparse/0/` and `transforms.json` below `folder`; returns the model's paths. pictures: by view, theirs."""
    back = source_from_normalised(posed.metadata)
    points = load_points(posed.path(posed.metadata.points))
    points = points.select(find_unmasked(points, [v.hole for v in views]))
    model = build_model(views, points, back, {name: Path(path).name for name, path in pictures.items()})
    target = folder / "sparse" / "0"
    target.mkdir(parents=True)
    model.write_binary(str(target))
    model.write_text(str(target))
    frames = [describe_frame(v, back, pictures[v.name]) for v in views]
    (folder / "transforms.json").write_text(json.dumps({"camera_model": "OPENCV", "frames": frames}, indent=1) + "\n")
    return sorted(f"sparse/0/{path.name}" for path in target.iterdir())


def source_from_normalised(posed: PosedCapture) -> Similarity:
    """The similarity that takes the normalised world back to the source's."""
    matrix = np.array(posed.source_from_normalised, np.float64)
    scale = posed.source_from_normalised_scale
    return Similarity(scale, matrix[:, :3] / scale, matrix[:, 3])


def build_model(
    views: Sequence[PlateView], points: SparsePoints, back: Similarity, names: Mapping[str, str]
) -> pycolmap.Reconstruction:
    """COLMAP's reconstruction: a camera for each lens, an image for each plate, points with their tracks."""
    model = pycolmap.Reconstruction()
    cameras: dict[tuple[Any, ...], int] = {}
    owners = points.track_frame
    pixels = _find_captured_pixels(views, points)
    place = np.zeros(len(owners), np.int64)
    for number, view in enumerate(views):
        lens = view.camera.lens
        key = (lens.model_name, lens.width, lens.height, *lens.params)
        if key not in cameras:
            cameras[key] = len(cameras) + 1
            own = pycolmap.Camera(
                camera_id=cameras[key], model=lens.model, width=lens.width, height=lens.height, params=list(lens.params)
            )
            model.add_camera_with_trivial_rig(own)
        rows = np.flatnonzero(owners == number)
        place[rows] = np.arange(len(rows))
        pose = back.pose(view.camera.posed.world_from_cam)
        world_from_cam = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:, :3]), pose[:, 3])
        image = pycolmap.Image(
            name=names[view.name], image_id=number + 1, camera_id=cameras[key],
            points2D=pycolmap.Point2DList([pycolmap.Point2D(xy) for xy in pixels[rows]]),
        )  # fmt: skip
        model.add_image_with_trivial_frame(image, world_from_cam.inverse())
    xyz = back.points(points.xyz)
    for number in range(len(points)):
        rows = range(int(points.track_offsets[number]), int(points.track_offsets[number + 1]))
        track = pycolmap.Track([pycolmap.TrackElement(int(owners[row]) + 1, int(place[row])) for row in rows])
        model.add_point3D(xyz[number], track, points.rgb[number])
    return model


def _find_captured_pixels(views: Sequence[PlateView], points: SparsePoints) -> Floats:
    """The tracks' pixels [t, 2] in the photos instead of the undistorted views."""
    pixels: NDArray[np.float64] = np.zeros((len(points.track_frame), 2))
    for number, view in enumerate(views):
        rows = points.track_frame == number
        camera = view.camera.posed
        if rows.any():
            plane = (points.track_xy[rows].astype(np.float64) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
            pixels[rows] = view.camera.project(plane)
    return pixels


def describe_frame(view: PlateView, back: Similarity, picture: str) -> dict[str, Any]:
    """A frame of nerfstudio's transforms.json, its lens with it: OPENCV holds every model that is read here."""
    lens = view.camera.lens
    pose = np.concatenate([back.pose(view.camera.posed.world_from_cam), [[0.0, 0.0, 0.0, 1.0]]])
    k1, k2, p1, p2 = distortion(lens)
    return {
        "file_path": picture,
        "w": lens.width,
        "h": lens.height,
        "fl_x": lens.focal_length_x,
        "fl_y": lens.focal_length_y,
        "cx": lens.principal_point_x,
        "cy": lens.principal_point_y,
        "k1": k1,
        "k2": k2,
        "p1": p1,
        "p2": p2,
        "transform_matrix": (pose @ OPENGL).tolist(),
    }


def distortion(lens: pycolmap.Camera) -> tuple[float, float, float, float]:
    """k1, k2, p1, p2 of OpenCV's model; those that a simpler one lacks are 0."""
    extra = [float(lens.params[i]) for i in lens.extra_params_idxs()]
    k1, k2, p1, p2 = [*extra, 0.0, 0.0, 0.0, 0.0][:4]
    return k1, k2, p1, p2
