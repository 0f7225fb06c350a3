"""The photos at their own size with the hole filled, as a data set."""

from collections.abc import Sequence
from pathlib import Path

import cv2

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import (
    Capture,
    CleanPlate,
    CleanPlates,
    CompletedViews,
    MaskSet,
    PaintedViews,
    PosedCapture,
)
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.cameras import measure_apart
from inpaint3d.scene.image_io import write_mask
from inpaint3d.scene.paintings import Painting, read_painting
from inpaint3d.stages.plate_export.canvases import write_canvas
from inpaint3d.stages.plate_export.config import Config
from inpaint3d.stages.plate_export.consistency import measure_consistency
from inpaint3d.stages.plate_export.dataset import write_dataset
from inpaint3d.stages.plate_export.held_out import complete_held_out
from inpaint3d.stages.plate_export.photo_files import Colours, to_colours, write_plate
from inpaint3d.stages.plate_export.photos import Photos, reduce_area
from inpaint3d.stages.plate_export.plate import Plate, make_plate
from inpaint3d.stages.plate_export.views import PlateView, load_views


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Write `clean-plates`: those first whose made-up surfaces are carried to the others."""
    cv2.setNumThreads(ctx.threads)
    posed, completed = inputs.one("posed-capture", PosedCapture), inputs.one("completed-views", CompletedViews)
    views = load_views(inputs.one("capture", Capture), posed, inputs.one("mask-set", MaskSet), completed)
    views = [v if v.completed else complete_held_out(v, views) for v in views]
    painted = load_canvases(inputs.optional("painted-views", PaintedViews), views)
    folder = outputs.folder("clean-plates")
    photos = Photos(views, config.photo_cache)
    order = order_views(views, list(painted), completed.metadata.reference_views)
    carried = [i for i, v in enumerate(views) if v.name in painted or v.name in completed.metadata.reference_views]
    records: dict[str, CleanPlate] = {}
    small: dict[str, Colours] = {}
    for done, index in enumerate(order):
        view = views[index]
        ctx.progress(done, len(order), view.name)
        made = [i for i in order[:done] if i in carried]
        plate = make_plate(
            index, views, photos, config,
            plates=rank_carried(view, made, views, painted), painting=painted.get(view.name), seed=ctx.seed,
        )  # fmt: skip
        if index not in carried:
            photos.drop_plate(view.name)
        records[view.name] = write(folder, view, plate, photos)
        cell = max(1, round(view.camera.lens.width / view.camera.posed.width))
        small[view.name] = to_colours(reduce_area(plate.codes[..., : photos.file(view.name).colours], cell))
    wanted = [v for v in views if v.name in (*painted, *completed.metadata.reference_views)]
    canvases = [write_canvas(folder, v, folder / records[v.name].picture) for v in wanted]
    model = write_dataset(folder, posed, views, {name: record.picture for name, record in records.items()})
    consistency = measure_consistency(views, photos, small)
    if consistency is not None:
        ctx.log(f"plates differ by {consistency.hole:.4f} in the hole, {consistency.known:.4f} beside it")
    outputs.write(
        "clean-plates",
        CleanPlates(
            plates=tuple(records[v.name] for v in views),
            model=tuple(model),
            canvases=tuple(canvases),
            consistency=consistency,
        ),
    )
    ctx.progress(1, 1, "written")


def order_views(views: Sequence[PlateView], painted: Sequence[str], references: Sequence[str]) -> list[int]:
    """Numbers of the views: painted ones, then reference views as completion took them, then the others."""
    by_name = {v.name: i for i, v in enumerate(views)}
    first = [by_name[name] for name in dict.fromkeys([*painted, *references]) if name in by_name]
    return [*first, *(i for i in range(len(views)) if i not in first)]


def rank_carried(
    view: PlateView, made: Sequence[int], views: Sequence[PlateView], painted: dict[str, Painting]
) -> list[int]:
    """Plates that this one may take from: painted ones, the nearest first, then the others as they were made."""
    by_hand = [i for i in made if views[i].name in painted]
    return [
        *sorted(by_hand, key=lambda i: measure_apart(view.camera.posed, views[i].camera.posed)),
        *(i for i in made if i not in by_hand),
    ]


def load_canvases(painted: Artifact[PaintedViews] | None, views: Sequence[PlateView]) -> dict[str, Painting]:
    """What was painted, by view. BadInputError for a view that is not of this capture."""
    if painted is None:
        return {}
    sizes = {v.name: (v.camera.lens.width, v.camera.lens.height) for v in views}
    canvases: dict[str, Painting] = {}
    for one in painted.metadata.views:
        if (size := sizes.get(one.name)) is None:
            raise BadInputError(f"painted view {one.name} is no view of this capture; there are {', '.join(sizes)}")
        painting = read_painting(painted, one)
        if painting.picture.shape[1::-1] == size:  # else it is no finer than completion's picture
            canvases[one.name] = painting
    return canvases


def write(folder: Path, view: PlateView, plate: Plate, photos: Photos) -> CleanPlate:
    """Write a plate's picture and mask; returns its record."""
    file = photos.file(view.name)
    picture, mask = f"images/{view.name}{file.suffix}", f"masks/{view.name}.png"
    write_plate(folder / picture, plate.codes, file)
    write_mask(folder / mask, plate.filled)
    height, width = plate.filled.shape
    return CleanPlate(
        name=view.name,
        picture=picture,
        mask=mask,
        width=width,
        height=height,
        shares=plate.shares,
        shift_px=round(plate.shift_px, 4),
        grain=round(plate.grain, 6),
    )
