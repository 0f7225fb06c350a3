"""Posed photos at the size that everything is measured at."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import MaskSet, MaskView
from inpaint3d.contracts.store import Artifact
from inpaint3d.radiance.artifact import reduce_camera
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.image_io import Image, Mask, read_mask


@dataclass(frozen=True, eq=False)
class Photo:
    """One photo [h, w, 3] with its camera at that size.

    hole [h, w]: at least half of the pixel lies inside the mask; known [h, w]: none of it does, and the
    camera saw it. exposure: the training view, by its number, whose appearance code fields show it with; None: the
    mean code.
    """

    name: str
    split: str
    camera: Camera
    image: Image
    hole: Mask
    known: Mask
    exposure: int | None = None


def load_photo(view: View, mask: Mask | None, longest_side: int) -> Photo:
    """Read a view and reduce it by exact area means. Raises BadInputError where the mask has another size."""
    full = (view.camera.height, view.camera.width)
    mask = np.zeros(full, bool) if mask is None else mask
    if mask.shape != full:
        raise BadInputError(
            f"the mask of view {view.name} is {mask.shape[1]}x{mask.shape[0]} but its frame is "
            f"{full[1]}x{full[0]}; re-run mask-authoring on these frames"
        )
    camera = reduce_camera(view.camera, longest_side)
    size = (camera.height, camera.width)
    coverage, unseen = (resize_by_area(m.astype(np.float32), size) for m in (mask, ~view.valid()))
    return Photo(
        name=view.name,
        split=view.split,
        camera=camera,
        image=resize_by_area(view.image(), size),
        hole=coverage >= 0.5,
        known=(coverage < 1e-6) & (unseen < 1e-6),
    )


def assign_exposures(photos: Sequence[Photo]) -> list[Photo]:
    """The photos, each with the exposure of its own training view or, kept out of training, of the nearest one.

    The exposure of a held-out photo is not the field's to know; that of its neighbour is, as for a warped photo.
    """
    train = [p.camera for p in photos if p.split == "train"]

    def nearest(camera: Camera) -> int | None:
        return min(range(len(train)), key=lambda i: camera_distance(camera, train[i]), default=None)

    return [replace(photo, exposure=nearest(photo.camera)) for photo in photos]


def camera_distance(a: Camera, b: Camera) -> float:
    """Distance of the centres plus the turn between the axes: a near camera that looks away is not near."""
    return float(np.linalg.norm(a.centre - b.centre) + 1.0 - a.forward @ b.forward)


def resize_by_area(values: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """[h, w] or [h, w, c] at another size (height, width), each pixel the mean of the area that it covers."""
    from skimage.transform import resize_local_mean

    if values.shape[:2] == size:
        return values
    channel_axis = 2 if values.ndim == 3 else None
    resized = resize_local_mean(values, size, channel_axis=channel_axis, preserve_range=True)
    return np.asarray(resized, np.float32)


def read_masks(masks: Artifact[MaskSet], views: Sequence[MaskView]) -> dict[str, Mask]:
    """The masks of some views of a mask-set, by the name of the view."""
    return {view.name: read_mask(masks.path(view.mask)) for view in views}
