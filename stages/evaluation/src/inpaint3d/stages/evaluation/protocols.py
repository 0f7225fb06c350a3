"""The protocols that have a truth, one function each: what is compared with what, on which pixels."""

import math

import numpy as np
from numpy.typing import ArrayLike

from inpaint3d.contracts.models.artifacts import Protocol
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.psnr import psnr
from inpaint3d.stages.evaluation.baselines import interpolate_depth, mean_colour, mean_surround, nearest_photo_warped
from inpaint3d.stages.evaluation.bench import Bench, compare_pictures, describe_resolution, ring_width, set_distances
from inpaint3d.stages.evaluation.boxes import mask_box
from inpaint3d.stages.evaluation.config import Config
from inpaint3d.stages.evaluation.hole import gradient_share
from inpaint3d.stages.evaluation.photos import Photo
from inpaint3d.stages.evaluation.protocol_names import (
    FULL,
    HELD_OUT,
    HOLE,
    LITE0,
    LPIPS_NETWORKS,
    MEAN_COLOUR,
    MEAN_SURROUND,
    SAMPLES,
    SPIN_NERF,
    SRGB,
    WARPED,
)


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
            resolution=describe_resolution(config),
            colour_range=SRGB,
            networks=(*LPIPS_NETWORKS, LITE0) if config.perceptual else (),
            views=len(truths),
            metrics=(*bench.scores.means(name), *sets),
        ),
        Protocol(
            name=HOLE,
            description=f"The same {len(truths)} views; only pixels inside the mask itself.",
            crop="pixels of which at least half lies inside the mask",
            resolution=describe_resolution(config),
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
            resolution=describe_resolution(bench.config),
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
            resolution=describe_resolution(bench.config),
            colour_range=SRGB,
            networks=LPIPS_NETWORKS if bench.config.perceptual else (),
            views=done,
            metrics=tuple(bench.scores.means(HELD_OUT)),
        )
    ]


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
