"""Masks in the truth cameras, for evaluation only: their pictures are never opened."""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import PosedTruth
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.reprojection import sparse_depth
from inpaint3d.stages.mask_authoring.cloud import join, lift
from inpaint3d.stages.mask_authoring.views import DepthView, camera_distances

NEIGHBOURS = 4  # captured views whose depth is shown in a truth camera
COARSER = 2  # than the depth maps, so that few pixels stay without a point


def truth_views(truth: Artifact[PosedTruth], views: list[DepthView]) -> list[DepthView]:
    """The truth cameras with depth from the captured views around them; where none shows a surface, inf."""
    cameras = [Camera.from_model(frame) for frame in truth.metadata.frames]
    seen = [v.camera for v in views]
    result = []
    for frame, camera in zip(truth.metadata.frames, cameras, strict=True):
        nearest = np.argsort(camera_distances([camera, *seen])[0, 1:], kind="stable")[:NEIGHBOURS]
        result.append(DepthView(frame.name, camera, _depth(camera, [views[i] for i in nearest]), _no_picture))
    return result


def _depth(camera: Camera, neighbours: list[DepthView]) -> NDArray[np.float64]:
    """Depth z of the nearest surface that the neighbours see, at half their maps' size."""
    height, width = (max(1, side // COARSER) for side in neighbours[0].depth.shape)
    everything = [lift(v, np.ones((v.camera.height, v.camera.width), bool)) for v in neighbours]
    return sparse_depth(camera.resize_to(width, height), join(everything).points)


def _no_picture() -> Image:
    raise RuntimeError("pictures of truth views are for evaluation alone")
