"""The protocols that need no truth, one function each: what the hole itself says, and views beside views."""

from itertools import combinations

import numpy as np

from inpaint3d.contracts.models.artifacts import Protocol
from inpaint3d.perception import lpips
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.reprojection import warp_image
from inpaint3d.stages.evaluation.baselines import ring_around
from inpaint3d.stages.evaluation.bench import Bench, ring_width
from inpaint3d.stages.evaluation.boxes import mask_box
from inpaint3d.stages.evaluation.hole import gradient_ratio, opacity_figures, reprojection_figures
from inpaint3d.stages.evaluation.photos import Photo, camera_distance
from inpaint3d.stages.evaluation.protocol_names import CONSISTENCY, EACH_PAIR, STATISTICS, VARIETY, Z_TOLERANCE


def score_holes(bench: Bench, photos: list[Photo]) -> list[Protocol]:
    """`hole-statistics`: what needs no truth: is the hole opaque, and is it as lively as its surround?"""
    done = 0
    for photo in photos:
        box = mask_box(photo.hole, 0.0)
        renders = {m.label: bench.render_full_view(m, photo) for m in bench.methods}
        if box is None or not bench.check_finite(renders, photo.name):
            continue
        ring = ring_around(photo.hole, ring_width(bench.config, box.width, box.height)) & photo.known
        for label, maps in renders.items():
            figures = opacity_figures(maps["opacity"], photo.hole)
            method = next(m for m in bench.methods if m.label == label)
            figures["depth_spread"] = method.depth_spread(photo, photo.hole, bench.config.block)
            ratio = gradient_ratio(maps["rgb"], photo.hole, ring)
            if ratio is not None:
                figures["gradient_ratio"] = ratio
            bench.scores.add(STATISTICS, label, photo.name, figures)
        done += 1
    if not done:
        return []
    return [
        Protocol(
            name=STATISTICS,
            description=f"Inside the mask of {done} views of the capture; needs no truth. Opacity below 1 is fog "
            "or a gap. Gradient energy of the render inside the mask over that in a ring around it: near 1 is "
            "alike, near 0 is blurred, well above 1 is noise. Spread of depth: standard deviation of where a ray's "
            "light stops, over its mean distance; a surface is near 0.",
            metrics=tuple(bench.scores.means(STATISTICS)),
        )
    ]


def score_neighbouring_views(bench: Bench, photos: list[Photo], others: list[Photo]) -> list[Protocol]:
    """`neighbouring-views`: is what fills the hole the same thing from the next camera?"""
    done = 0
    for photo in photos:
        rest = [o for o in others if o.name != photo.name]
        if not photo.hole.any() or not rest:
            continue
        neighbour = min(rest, key=lambda o: camera_distance(photo.camera, o.camera))
        here, there = ({m.label: bench.render_full_view(m, p) for m in bench.methods} for p in (photo, neighbour))
        if not (bench.check_finite(here, photo.name) and bench.check_finite(there, neighbour.name)):
            continue
        for label, maps in here.items():
            beside = there[label]
            warped, seen = warp_image(
                beside["rgb"], neighbour.camera, beside["depth"], photo.camera, maps["depth"], Z_TOLERANCE
            )
            figures = reprojection_figures(maps["rgb"], warped, seen, photo.hole, photo.known)
            bench.scores.add(CONSISTENCY, label, photo.name, figures)
        done += 1
    metrics = tuple(bench.scores.means(CONSISTENCY))
    if not metrics:  # no surface is seen by two views: there is nothing to compare
        return []
    return [
        Protocol(
            name=CONSISTENCY,
            description=f"{done} views, each beside the render of the nearest other camera of the capture, warped to "
            f"it by both renders' depths where they agree within {Z_TOLERANCE:.0%}: mean absolute difference of "
            "colours. Needs no truth; the known pixels' figure is what geometry and view dependence cost by "
            "themselves.",
            metrics=metrics,
        )
    ]


def compare_seeds(bench: Bench, photos: list[Photo]) -> list[Protocol]:
    """`between-seeds`: how much fields that differ in their seed alone differ in the hole, each two of them."""
    first = bench.methods[0].artifact.metadata.label
    alike = {m.artifact.metadata.seed: m for m in bench.methods if m.artifact.metadata.label == first}
    pairs = list(combinations([m.label for m in alike.values()], 2))
    done = 0
    for photo in photos:
        box = mask_box(photo.hole, bench.config.box_growth)
        renders = {m.label: bench.render_full_view(m, photo) for m in alike.values()}
        if not pairs or box is None or not bench.check_finite(renders, photo.name):
            continue
        crops = {label: np.ascontiguousarray(maps["rgb"][box.slices]) for label, maps in renders.items()}
        rows = {f"{a} | {b}": _measure_difference(crops[a], crops[b], photo.hole[box.slices], bench) for a, b in pairs}
        rows[EACH_PAIR] = {n: float(np.mean([f[n] for f in rows.values()])) for n in next(iter(rows.values()))}
        for label, figures in rows.items():
            bench.scores.add(VARIETY, label, photo.name, figures)
        done += 1
    if not done:
        return []
    return [
        Protocol(
            name=VARIETY,
            description=f"{len(alike)} completions that differ in their seed alone, each two of them beside each other "
            f"in {done} views: LPIPS of the crops to the hole's box, and mean absolute difference of colours inside "
            f"the mask. {EACH_PAIR}: their mean. What other photos show of the hole is the same for every seed.",
            metrics=tuple(bench.scores.means(VARIETY)),
        )
    ]


def _measure_difference(one: Image, other: Image, hole: np.ndarray, bench: Bench) -> dict[str, float]:
    figures = {"colour_between": float(np.abs(one - other)[hole].mean())}
    if bench.config.perceptual:
        figures["lpips_between"] = lpips.load("vgg", bench.device).distance(one, other)
    return figures
