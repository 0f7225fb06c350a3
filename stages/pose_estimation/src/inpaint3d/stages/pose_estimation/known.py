"""Cameras that came with the data: passed through as they are, points triangulated between them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap

from inpaint3d.contracts.artifacts import CapturedFrame, KnownCamera
from inpaint3d.contracts.context import Context


def colmap_camera(known: KnownCamera, width: int, height: int, number: int) -> pycolmap.Camera:
    """The data set's camera as COLMAP's."""
    return pycolmap.Camera(
        camera_id=number, model=known.model, width=width, height=height, params=np.array(known.params)
    )


def cam_from_world(known: KnownCamera) -> pycolmap.Rigid3d:
    """The inverse of `world_from_cam`, its rotation made orthonormal (data sets round their matrices)."""
    pose = np.array(known.world_from_cam)
    u, _, vt = np.linalg.svd(pose[:, :3])
    rotation = (u @ vt).T
    return pycolmap.Rigid3d(np.concatenate([rotation, (-rotation @ pose[:, 3])[:, None]], 1))


def posed_model(frames: Sequence[CapturedFrame], names: Sequence[str], database: Path) -> pycolmap.Reconstruction:
    """A model of the known cameras with the database's features, without points. Equal cameras are one."""
    model = pycolmap.Reconstruction()
    numbers: dict[tuple[object, ...], int] = {}
    with pycolmap.Database.open(database) as opened:
        for frame, name in zip(frames, names, strict=True):
            if frame.camera is None:
                continue
            identity = (frame.camera.model, frame.camera.params, frame.width, frame.height)
            if identity not in numbers:
                numbers[identity] = len(numbers) + 1
                camera = colmap_camera(frame.camera, frame.width, frame.height, numbers[identity])
                model.add_camera_with_trivial_rig(camera)
            stored = opened.read_image_with_name(name)
            keypoints = opened.read_keypoints(stored.image_id)[:, :2].astype(np.float64)
            image = pycolmap.Image(
                name=name, keypoints=keypoints, camera_id=numbers[identity], image_id=stored.image_id
            )
            model.add_image_with_trivial_frame(image, cam_from_world(frame.camera))
    return model


def triangulated(
    model: pycolmap.Reconstruction, database: Path, pictures: Path, folder: Path, ctx: Context
) -> pycolmap.Reconstruction:
    """Points between the fixed cameras."""
    folder.mkdir(exist_ok=True)
    options = pycolmap.IncrementalPipelineOptions(num_threads=ctx.threads, random_seed=ctx.seed)
    return pycolmap.triangulate_points(model, database, pictures, folder, options=options)
