"""Score the fields by every protocol that the inputs allow, and draw them."""

from dataclasses import replace
from pathlib import Path

import torch

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import (
    DiffusionPrior,
    Evaluation,
    MaskSet,
    PictureStrip,
    PosedCapture,
    PosedTruth,
    RadianceFieldArtifact,
)
from inpaint3d.contracts.store import Artifact
from inpaint3d.radiance.artifact import reduce_camera
from inpaint3d.radiance.held_out import KnownPhoto
from inpaint3d.scene.capture_io import load_points, load_posed
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.masked_views import load_masked_scene
from inpaint3d.scene.selection import choose_evenly
from inpaint3d.stages.evaluation.bench import Bench, Tick
from inpaint3d.stages.evaluation.config import Config
from inpaint3d.stages.evaluation.hole_protocols import compare_seeds, score_holes, score_neighbouring_views
from inpaint3d.stages.evaluation.methods import load_methods
from inpaint3d.stages.evaluation.notes import LIMITS, list_weaknesses
from inpaint3d.stages.evaluation.photos import (
    Photo,
    assign_exposures,
    load_photo,
    read_masks,
)
from inpaint3d.stages.evaluation.pictures import (
    DIFFERENCE_GAIN,
    GAP,
    choose_clearest_view,
    colour_depth,
    colour_difference,
    hide_hole,
    outline_hole,
    set_side_by_side,
)
from inpaint3d.stages.evaluation.prior import held_out_crops
from inpaint3d.stages.evaluation.protocols import (
    score_against_truth,
    score_held_out,
    score_held_out_samples,
    score_whole_views,
)
from inpaint3d.stages.evaluation.sparse import score_sparse_points

CONTACT = "pictures/before_mask_after_depth.png"


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Evaluate the fields; nothing is written before every protocol is done."""
    torch.set_num_threads(ctx.threads)
    capture = inputs.one("posed-capture", PosedCapture)
    masks = inputs.one("mask-set", MaskSet)
    truth = inputs.optional("posed-truth", PosedTruth)
    prior = inputs.optional("diffusion-prior", DiffusionPrior)
    methods = load_methods(inputs.many("radiance-fields", RadianceFieldArtifact), ctx.device)
    if not methods:
        raise BadInputError("evaluation needs at least one radiance field; wire one to its input radiance-fields")

    photos = _load_photos(capture, masks, config.render_longest_side)
    truths = _choose_truths(truth, masks, config)
    train = [p for p in photos if p.split == "train"]
    test = choose_evenly([p for p in photos if p.split == "test"], config.held_out_views)
    # Statistics of the hole reuse the renders of held-out views where there are any.
    shown = test or choose_evenly(train, min(len(train), max(1, config.picture_views)))

    whole_truths = {p.name for n in (config.full_views, config.picture_views) for p in choose_evenly(truths, n)}
    whole = len({p.name for p in test + shown}) + config.neighbour_views + len(whole_truths)
    steps = len(truths) + len(methods) * whole + 1
    bench = Bench(methods, config, tick=_make_counter(ctx, steps))
    held_out = [KnownPhoto(v.camera, v.image, v.known) for v in load_masked_scene(capture, masks).test]
    points = load_points(capture.path(capture.metadata.points))
    done = [
        *score_against_truth(bench, truths),
        *score_whole_views(bench, choose_evenly(truths, config.full_views)),
        *score_held_out(bench, test, train, points.xyz),
        *score_held_out_samples(bench, held_out, config.held_out_pixels),
        *score_holes(bench, shown),
        *score_neighbouring_views(bench, choose_evenly(shown, config.neighbour_views), photos),
        *compare_seeds(bench, shown),
        *score_sparse_points(bench, [v.camera for v in load_posed(capture)], photos, points),
        *(held_out_crops(prior.metadata) if prior else []),
    ]

    folder = outputs.folder("evaluation")
    (folder / "pictures").mkdir()
    contact = _make_contact_strip(bench, photos, capture, masks, folder)
    strips = [
        *_make_strips(bench, choose_evenly(truths, config.picture_views), folder, "truth"),
        *_make_strips(bench, choose_evenly(shown, config.picture_views), folder, "photo"),
    ]
    bench.scores.write(folder / "per_view.csv")
    ctx.non_finite.update(bench.non_finite)
    outputs.write(
        "evaluation",
        Evaluation(
            protocols=tuple(done),
            pictures=tuple(str(p.relative_to(folder)) for p in sorted((folder / "pictures").iterdir())),
            contact=contact,
            strips=tuple(strips),
            weaknesses=tuple(list_weaknesses(methods[0].label, done, masks.metadata, truth=bool(truths))),
            limits=LIMITS,
            non_finite=bench.non_finite,
        ),
    )
    ctx.progress(steps, steps, "written")


def _load_photos(capture: Artifact[PosedCapture], masks: Artifact[MaskSet], longest_side: int) -> list[Photo]:
    """Every photo of the capture with its mask. Raises BadInputError for a photo without a mask."""
    known = read_masks(masks, masks.metadata.views)
    views = load_posed(capture)
    if missing := [v.name for v in views if v.name not in known]:
        raise BadInputError(
            f"mask-set has no mask for view {missing[0]} ({len(missing)} in all); re-run mask-authoring"
        )
    return assign_exposures([load_photo(view, known[view.name], longest_side) for view in views])


def _choose_truths(truth: Artifact[PosedTruth] | None, masks: Artifact[MaskSet], config: Config) -> list[Photo]:
    """Truth views that show some of the hole, spread evenly; where no mask was made, the one that came with a view."""
    if truth is None:
        return []
    drawn = read_masks(masks, masks.metadata.truth_views)
    photos = []
    for view in load_posed(truth):
        mask = drawn.get(view.name)
        mask = view.mask() if mask is None else mask
        if mask is not None and mask.any():
            photos.append(load_photo(view, mask, config.render_longest_side))
    return choose_evenly(photos, config.truth_views)


def _make_contact_strip(
    bench: Bench, photos: list[Photo], capture: Artifact[PosedCapture], masks: Artifact[MaskSet], folder: Path
) -> PictureStrip:
    """Before, mask, after, depth: the first field in the view that shows the hole best."""
    views = load_posed(capture)
    known = read_masks(masks, masks.metadata.views)
    view = views[choose_clearest_view([known[v.name] for v in views])]
    camera = reduce_camera(view.camera, bench.config.contact_longest_side)
    photo = replace(
        load_photo(view, known[view.name], max(camera.width, camera.height)),
        exposure=next(p.exposure for p in photos if p.name == view.name),
    )
    maps = bench.methods[0].render(photo, bench.config.block)
    bench.tick(f"contact picture of {view.name}")
    panels = [photo.image, hide_hole(photo.image, photo.hole), maps["rgb"], colour_depth(maps["depth"])]
    write_png(folder / CONTACT, set_side_by_side(panels))
    captions = ("before", "mask", f"after ({bench.methods[0].label})", "depth")
    return PictureStrip(view=view.name, file=CONTACT, captions=captions, gap=GAP)


def _make_strips(bench: Bench, photos: list[Photo], folder: Path, kind: str) -> list[PictureStrip]:
    """One row of panels for each view: the photo with its mask, every field, the first field's depth, the truth."""
    strips = []
    for photo in photos:
        renders = [bench.render_full_view(m, photo) for m in bench.methods]
        panels = [
            outline_hole(photo.image, photo.hole),
            *(r["rgb"] for r in renders),
            colour_depth(renders[0]["depth"]),
        ]
        captions = [f"{kind}, hole outlined", *(m.label for m in bench.methods), f"depth of {bench.methods[0].label}"]
        if kind == "truth":
            panels += [photo.image, colour_difference(renders[0]["rgb"], photo.image)]
            captions += ["truth", f"difference of {bench.methods[0].label} from it, x{DIFFERENCE_GAIN}"]
        file = f"pictures/{kind}_{photo.name}.png"
        write_png(folder / file, set_side_by_side(panels))
        strips.append(PictureStrip(view=f"{photo.name} ({kind})", file=file, captions=tuple(captions), gap=GAP))
    return strips


def _make_counter(ctx: Context, total: int) -> Tick:
    done = 0

    def tick(message: str) -> None:
        nonlocal done
        done += 1
        ctx.progress(min(done, total), total, message)

    return tick
