"""Masks grown by the shadows that were asked for and found, and the evidence for each."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts.mask_sets import PlaneShadow
from inpaint3d.scene.colour import srgb_from_linear
from inpaint3d.scene.image_io import Image, write_png
from inpaint3d.stages.mask_authoring.authored import Authored
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.scene import Scene
from inpaint3d.stages.mask_authoring.shadows import Shadow, find_shadows, show_shadow
from inpaint3d.stages.mask_authoring.surroundings import find_planes
from inpaint3d.stages.mask_authoring.views import DepthView

Bools = NDArray[np.bool_]

ENLARGED = 3  # pixels of the evidence's picture for a cell


def look_for_shadows(scene: Scene, authored: Authored, config: Config) -> list[Shadow]:
    """On every plane that what is masked touches: also those too weak to be believed."""
    planes = find_planes(scene.points, scene.small(config.segment_size)) if scene.planes is None else scene.planes
    return find_shadows(planes, scene.depth_views, authored.masks)


def grow_by_shadows(authored: Authored, shadows: Sequence[Shadow], scene: Scene) -> Authored:
    """Masks of the posed views and the truth cameras with what lies in a shadow that was found."""
    found = [shadow for shadow in shadows if shadow.found]
    if not found:
        return authored
    masks, truth = (
        [_add(mask, found, view) for mask, view in zip(masks, views, strict=True)]
        for masks, views in ((authored.masks, scene.depth_views), (authored.truth_masks, scene.truth))
    )
    return replace(
        authored,
        masks=masks,
        truth_masks=truth,
        method=f"{authored.method}; grown by its shadow on {len(found)} planes",
    )


def report_shadows(
    folder: Path, shadows: Sequence[Shadow], views: Sequence[DepthView], masks: Sequence[Bools], ctx: Context
) -> tuple[PlaneShadow, ...]:
    """Write a picture of each below `folder`, say what was found, and return the records; masks: without shadows."""
    records: list[PlaneShadow] = []
    for number, shadow in enumerate(shadows):
        path = f"shadows/{number}.png"
        x, y, z = map(float, shadow.grid.plane.normal)
        write_png(folder / path, draw_shadow(shadow))
        added = {
            view.name: float((show_shadow(shadow, view) & ~mask).mean()) if shadow.found else 0.0
            for view, mask in zip(views, masks, strict=True)
        }
        records.append(
            PlaneShadow(
                normal=(x, y, z),
                offset=shadow.grid.plane.offset,
                found=shadow.found,
                darkest=shadow.darkest,
                threshold=shadow.threshold,
                log_likelihood=shadow.gain,
                log_likelihood_by_chance=shadow.chance_gain,
                picture=path,
                added=added,
            )
        )
        ctx.log(describe(records[-1]))
    if not records:
        ctx.log("no shadow: what is masked touches no plane of the scene, or too little of the plane around it is seen")
    return tuple(records)


def describe(shadow: PlaneShadow) -> str:
    """One line for a person."""
    evidence = (
        f"it takes {shadow.darkest:.0%} of the light at most (by chance {shadow.threshold:.0%}), and explains the "
        f"plane by {shadow.log_likelihood:.0f} (elsewhere by {shadow.log_likelihood_by_chance:.0f})"
    )
    if not shadow.found:
        return f"no shadow to be sure of: {evidence}"
    return f"shadow found, {np.mean(list(shadow.added.values())):.2%} of the views' pixels: {evidence}"


def draw_shadow(shadow: Shadow) -> Image:
    """The plane from above, the light that is kept from it (black: half), and the plane with its shadow in green."""
    known = shadow.texture.known[..., None]
    colours = srgb_from_linear(np.where(known, np.exp(shadow.texture.log_colour), 0.0))
    kept = np.broadcast_to(1 - (2 * shadow.share[..., None]).clip(0, 1), colours.shape)
    inside = shadow.found & (shadow.share > shadow.threshold)[..., None]
    marked = np.where(inside, 0.5 * colours + (0.0, 0.5, 0.0), colours)
    row = np.concatenate([colours, kept, marked], 1)
    return row.repeat(ENLARGED, 0).repeat(ENLARGED, 1).astype(np.float32)


def _add(mask: Bools, shadows: Sequence[Shadow], view: DepthView) -> Bools:
    return np.logical_or.reduce([mask, *(show_shadow(shadow, view) for shadow in shadows)])
