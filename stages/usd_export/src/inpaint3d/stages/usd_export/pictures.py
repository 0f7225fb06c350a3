"""The pictures that textures are made of, and those that the result is held against."""

from collections.abc import Mapping, Sequence

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import CompletedViews, MaskSet
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.image_io import Mask, read_image, read_mask
from inpaint3d.stages.usd_export.fidelity import HeldOutPhoto
from inpaint3d.stages.usd_export.texture import Picture

Masks = Mapping[str, Mask]


def load_masks(masks: Artifact[MaskSet], views: Sequence[View]) -> dict[str, Mask]:
    """Each view's mask, bool [h, w], at the view's own size. BadInputError where one is missing."""
    files = {view.name: view.mask for view in masks.metadata.views}
    if missing := [view.name for view in views if view.name not in files]:
        raise BadInputError(
            f"mask-set has no mask for view {missing[0]} ({len(missing)} in all); re-run mask-authoring"
        )
    return {
        view.name: read_mask(masks.path(files[view.name]), (view.camera.width, view.camera.height)) for view in views
    }


def load_photos(views: Sequence[View], masks: Masks) -> list[Picture]:
    """The photographs whole, for the scene as it was."""
    return [Picture(view.camera, view.image(), view.valid(), masks[view.name]) for view in views]


def load_completed(views: Sequence[View], masks: Masks, completed: Artifact[CompletedViews] | None) -> list[Picture]:
    """Completed views where there are any; of other photographs what lies outside the mask.

    BadInputError where a completed view is of another size than its photograph.
    """
    files = {view.name: view.picture for view in completed.metadata.views} if completed else {}
    pictures: list[Picture] = []
    for view in views:
        mask = masks[view.name]
        if completed is None or view.name not in files:
            pictures.append(Picture(view.camera, view.image(), view.valid() & ~mask, mask))
            continue
        image = read_image(completed.path(files[view.name]))
        if image.shape[:2] != mask.shape:
            raise BadInputError(
                f"the completed view {view.name} has {image.shape[1]} x {image.shape[0]} pixels, its photo "
                f"{mask.shape[1]} x {mask.shape[0]}; re-run view-completion on this capture"
            )
        pictures.append(Picture(view.camera, image, view.valid() | mask, mask))
    return pictures


def load_held_out(views: Sequence[View], masks: Masks) -> list[HeldOutPhoto]:
    """The photographs of the test split, and their pixels outside the mask."""
    held_out = [view for view in views if view.split == "test"]
    return [HeldOutPhoto(view.camera, view.image(), view.valid() & ~masks[view.name]) for view in held_out]
