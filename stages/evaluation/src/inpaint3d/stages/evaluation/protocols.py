"""The protocols, one function each: what is compared with what, on which pixels."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import torch
from numpy.typing import ArrayLike

from inpaint3d.contracts.models.artifacts import Metric, Protocol
from inpaint3d.perception import lpips
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.reprojection import warp_image
from inpaint3d.stages.evaluation.baselines import (
    interpolate_depth,
    mean_colour,
    mean_surround,
    nearest_photo_warped,
    ring_around,
)
from inpaint3d.stages.evaluation.boxes import mask_box
from inpaint3d.stages.evaluation.config import Config
from inpaint3d.stages.evaluation.features import lite0_features
from inpaint3d.stages.evaluation.frechet import estimate_kernel_distance, frechet_distance
from inpaint3d.stages.evaluation.hole import gradient_ratio, gradient_share, opacity_figures, reprojection_figures
from inpaint3d.stages.evaluation.methods import Maps, Method, count_non_finite
from inpaint3d.stages.evaluation.metrics import ssim
from inpaint3d.stages.evaluation.photos import Photo, camera_distance
from inpaint3d.stages.evaluation.scores import Scores, metric

BOX = "bbox10-vgg"
SPIN_NERF = "spin-nerf"
HOLE = "masked-pixels"
FULL = "full"
HELD_OUT = "held-out-known-pixels"
SAMPLES = "held-out-samples"
STATISTICS = "hole-statistics"
CONSISTENCY = "neighbouring-views"
VARIETY = "between-seeds"
EACH_PAIR = "all pairs"
MEAN_SURROUND = "mean-surround"
MEAN_COLOUR = "mean-colour"
WARPED = "nearest-photo-warped"

SRGB = "sRGB-encoded, 0 to 1"
LPIPS_NETWORKS = ("LPIPS v0.1 VGG16", "LPIPS v0.1 AlexNet")
LITE0 = "EfficientNet-Lite0, 1280 pooled features"

Z_TOLERANCE = 0.02
"""Share of a depth by which the neighbour's own may differ for it to be the same surface."""

Tick = Callable[[str], None]


@dataclass
class Bench:
    """What all protocols share: the methods, the table, the renders so far, and the count of non-finite values."""

    methods: list[Method]
    config: Config
    tick: Tick
    scores: Scores = field(default_factory=Scores)
    non_finite: dict[str, int] = field(default_factory=dict)
    renders: dict[tuple[str, str], Maps] = field(default_factory=dict)

    @property
    def device(self) -> torch.device:
        """Where the fields lie, and where networks look at pictures."""
        return self.methods[0].field.device

    def render_full_view(self, method: Method, photo: Photo) -> Maps:
        """The whole view, rendered once."""
        key = (method.label, photo.name)
        if key not in self.renders:
            self.renders[key] = method.render(photo, self.config.block)
            self.tick(f"{method.label} in {photo.name}")
        return self.renders[key]

    def check_finite(self, renders: dict[str, Maps], view: str) -> bool:
        """Count the non-finite values of a view's renders; a view that has any is left out for every method."""
        counts = {label: count_non_finite(maps) for label, maps in renders.items()}
        for label, count in counts.items():
            if count:
                place = f"{label}/{view}"
                self.non_finite[place] = max(count, self.non_finite.get(place, 0))
        return not any(counts.values())


def score_against_truth(bench: Bench, photos: list[Photo]) -> list[Protocol]:
    """`bbox10-vgg` and `masked-pixels`: crops around the hole against views that show what is behind it."""
    config = bench.config
    name = name_box_protocol(config)
    crops: dict[str, list[Image]] = {}
    truths: list[Image] = []
    for photo in photos:
        tight, box = mask_box(photo.hole, 0.0), mask_box(photo.hole, config.box_growth)
        if tight is None or box is None:
            continue
        ring = ring_width(config, tight.width, tight.height)
        outer = box.grow(ring, ring, photo.camera.width, photo.camera.height)
        renders = {m.label: m.render(photo, config.block, outer) for m in bench.methods}
        bench.tick(f"crops of {photo.name}")
        if not bench.check_finite(renders, photo.name):
            continue
        pictures = {label: maps["rgb"] for label, maps in renders.items()}
        first = pictures[bench.methods[0].label]
        pictures[MEAN_SURROUND] = mean_surround(first, photo.hole[outer.slices], ring)
        truth, hole = photo.image[box.slices], photo.hole[box.slices]
        cut = {n: np.ascontiguousarray(p[box.relative_to(outer).slices]) for n, p in pictures.items()}
        for label, figures in compare_pictures(cut, truth, perceptual=config.perceptual, device=bench.device).items():
            bench.scores.add(name, label, photo.name, figures)
        for label, crop in cut.items():
            crops.setdefault(label, []).append(crop)
            figures = {"psnr": psnr(crop, truth, hole)}
            if (share := gradient_share(crop, truth, hole)) is not None:
                figures["gradient_share"] = share
            bench.scores.add(HOLE, label, photo.name, figures)
        truths.append(truth)
    if not truths:
        return []
    sets = set_distances(crops, truths, bench.device) if config.perceptual and len(truths) >= 2 else []
    return [
        Protocol(
            name=name,
            description=_describe_box(bench, len(truths)),
            crop=f"the mask's bounding box, {config.box_growth:.0%} wider and higher (half on each side, rounded up), "
            "cut to the picture",
            resolution=_describe_resolution(config),
            colour_range=SRGB,
            networks=(*LPIPS_NETWORKS, LITE0) if config.perceptual else (),
            views=len(truths),
            metrics=(*bench.scores.means(name), *sets),
        ),
        Protocol(
            name=HOLE,
            description=f"The same {len(truths)} views; only pixels inside the mask itself.",
            crop="pixels of which at least half lies inside the mask",
            resolution=_describe_resolution(config),
            colour_range=SRGB,
            views=len(truths),
            metrics=tuple(bench.scores.means(HOLE)),
        ),
    ]


def name_box_protocol(config: Config) -> str:
    """`bbox10-vgg` for a growth of 10 %, or the published protocol that the crops follow."""
    return SPIN_NERF if config.box_protocol == SPIN_NERF else f"bbox{100 * config.box_growth:g}-vgg"


def score_whole_views(bench: Bench, photos: list[Photo]) -> list[Protocol]:
    """`full`: whole views against the truth, most of which no method had to make up."""
    done = 0
    for photo in photos:
        renders = {m.label: bench.render_full_view(m, photo) for m in bench.methods}
        if not bench.check_finite(renders, photo.name):
            continue
        pictures = {label: maps["rgb"] for label, maps in renders.items()}
        scores = compare_pictures(pictures, photo.image, perceptual=bench.config.perceptual, device=bench.device)
        for label, figures in scores.items():
            bench.scores.add(FULL, label, photo.name, figures)
        done += 1
    if not done:
        return []
    return [
        Protocol(
            name=FULL,
            description=f"{done} whole views that show what is really behind the hole, with the mean exposure. Most of "
            "a view was seen by other photos: read the crops for what was made up.",
            crop="none: whole views",
            resolution=_describe_resolution(bench.config),
            colour_range=SRGB,
            networks=LPIPS_NETWORKS if bench.config.perceptual else (),
            views=done,
            metrics=tuple(bench.scores.means(FULL)),
        )
    ]


def score_held_out_samples(bench: Bench, photos: list[KnownPhoto], pixels: int) -> list[Protocol]:
    """`held-out-samples`: what the learning curves of masked fits are taken over, so that they end at these figures."""
    for method in bench.methods:
        found = HeldOut.at_random(photos, pixels, bench.device).psnr_of_each(method.field, bench.config.block)
        if broken := sum(map(math.isnan, found)):
            bench.non_finite[f"{method.label}/{SAMPLES}"] = broken
            return []
        for number, value in enumerate(found):
            bench.scores.add(SAMPLES, method.label, f"held-out {number}", {"psnr": value})
    metrics = tuple(bench.scores.means(SAMPLES))
    if not metrics:
        return []
    return [
        Protocol(
            name=SAMPLES,
            description=f"At most {pixels} known pixels of each photo kept out of training, always the same, rays at "
            "full size, mean exposure code: what the learning curves show while a field is fitted. "
            f"{HELD_OUT} compares whole pictures, reduced, with the nearest exposure: another figure.",
            crop="random known pixels",
            resolution="the posed frames' own",
            colour_range=SRGB,
            views=metrics[0].views,
            metrics=metrics,
        )
    ]


def _describe_resolution(config: Config) -> str:
    return f"at most {config.render_longest_side} px a side, reduced by exact area means"


def score_held_out(bench: Bench, test: list[Photo], train: list[Photo], points: ArrayLike) -> list[Protocol]:
    """`held-out-known-pixels`: test views outside the mask, beside two baselines that learn nothing."""
    average = mean_colour(train)
    done = 0
    for photo in test:
        renders = {m.label: bench.render_full_view(m, photo) for m in bench.methods}
        if not photo.known.any() or not bench.check_finite(renders, photo.name):
            continue
        pictures = {label: maps["rgb"] for label, maps in renders.items()}
        pictures[MEAN_COLOUR] = np.broadcast_to(average, photo.image.shape)
        depth = interpolate_depth(photo.camera, points)
        # without a sparse point in the view nothing can be warped: the baseline falls back to the mean colour
        pictures[WARPED] = (
            pictures[MEAN_COLOUR] if depth is None else nearest_photo_warped(photo.camera, depth, train, average)
        )
        # Unknown pixels are made equal, so that windows and features that touch them see no difference there.
        shown = {n: np.where(photo.known[..., None], p, photo.image).astype(np.float32) for n, p in pictures.items()}
        scores = compare_pictures(
            shown, photo.image, perceptual=bench.config.perceptual, region=photo.known, device=bench.device
        )
        for label, figures in scores.items():
            bench.scores.add(HELD_OUT, label, photo.name, figures)
        done += 1
    if not done:
        return []
    return [
        Protocol(
            name=HELD_OUT,
            description=f"{done} photos kept out of training, at most {bench.config.render_longest_side} px a "
            "side; pixels outside the mask only. PSNR and SSIM are means over known pixels; for SSIM's windows and "
            "LPIPS the other pixels are set to the photo's own, which lowers LPIPS alike for every "
            f"method. Fields use the exposure code of the nearest training photo. {MEAN_COLOUR}: the mean colour of "
            f"the training photos' known pixels; {WARPED}: the nearest training photo, warped by depth interpolated "
            "between the sparse points.",
            crop="known pixels: outside the mask, and seen by the camera",
            resolution=_describe_resolution(bench.config),
            colour_range=SRGB,
            networks=LPIPS_NETWORKS if bench.config.perceptual else (),
            views=done,
            metrics=tuple(bench.scores.means(HELD_OUT)),
        )
    ]


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


def compare_pictures(
    pictures: Mapping[str, Image],
    truth: Image,
    *,
    perceptual: bool,
    region: np.ndarray | None = None,
    device: torch.device | str = "cpu",
) -> dict[str, dict[str, float]]:
    """PSNR, SSIM and (where wanted) both LPIPS of each picture against one truth, by label; device: of the networks."""
    figures = {n: {"psnr": psnr(p, truth, region), "ssim": ssim(p, truth, region)} for n, p in pictures.items()}
    if perceptual:
        for network in ("vgg", "alex"):
            distances = lpips.load(network, device).distances(list(pictures.values()), truth)
            for label, distance in zip(pictures, distances, strict=True):
                figures[label][f"lpips_{network}"] = distance
    return figures


def set_distances(
    crops: dict[str, list[Image]], truths: list[Image], device: torch.device | str = "cpu"
) -> list[Metric]:
    """FD-lite0 and KID-lite0 of each method's crops to the truth's."""
    real = lite0_features(truths, device)
    out: list[Metric] = []
    for label, pictures in crops.items():
        made = lite0_features(pictures, device)
        out.append(metric(label, "fd_lite0", frechet_distance(made, real), len(truths)))
        kernel = estimate_kernel_distance(made, real)
        out.append(metric(label, "kid_lite0", kernel.value, len(truths), standard_error=kernel.standard_error))
    return out


def ring_width(config: Config, width: int, height: int) -> int:
    """Pixels of the ring around a mask whose tight box is width x height."""
    return max(2, round(config.ring * max(width, height)))


def _describe_box(bench: Bench, n: int) -> str:
    config = bench.config
    return (
        f"{n} views that show what is really behind the hole, at most {config.render_longest_side} px a "
        f"side. Each method is cropped to the bounding box of the mask grown by {config.box_growth:.0%}, "
        "and compared with the truth there; views with an empty mask are skipped, every method is on the "
        "same crops. SSIM: Gaussian 11x11 window, sigma 1.5. LPIPS v0.1 on [-1, 1]; crops with a side "
        "under 64 px are enlarged for it. FD-lite0 and KID-lite0 are the Frechet and the kernel distance "
        f"of {n} against {n} crops over EfficientNet-Lite0's 1280 pooled features: not FID and not KID, "
        f"rank deficient for n = {n} < 1280 and mostly bias at so few views; only comparisons within this "
        f"table mean anything. {MEAN_SURROUND}: the render of {bench.methods[0].label} with its hole "
        "filled by the mean colour of a ring around it."
    )
