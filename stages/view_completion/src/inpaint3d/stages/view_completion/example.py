"""A hole in one picture, filled by example: coarse to fine, each of its patches becomes like one of the known pixels.

Space-time completion (Wexler, Shechtman and Irani 2007, doi:10.1109/TPAMI.2007.60) on one picture: votes of overlapping
patches, weighted by likeness and by how near the known pixels are. Coarse levels try every patch, the coarsest of all
is peeled from outside as by Efros and Leung (1999, doi:10.1109/ICCV.1999.790383). From level to level goes where each
pixel came from, not its colour, and fine levels look only near where their neighbours were copied from (PatchMatch,
Barnes et al. 2009, doi:10.1145/1531326.1531330): what is copied stays in one piece, and sharp. Patches are compared by
how lively they are too (Newson et al. 2014, doi:10.1137/140954933), or what is smooth, never far off, would win.
"""

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.diffusion.fill import fill_telea
from inpaint3d.scene.image_io import Mask
from inpaint3d.scene.membrane import span_membrane
from inpaint3d.stages.view_completion.patches import PATCH, Origins, Patches, Picture

MIN_SOURCE = 500
"""Pixels of the source that the coarsest level holds at least."""
EXHAUSTIVE_LEVELS = 2
"""Coarse levels at which every example is tried."""
MAX_PAIRS = 30_000_000
"""Patches to fill times examples beyond which the finest level is no such, unless it is the only one."""
LOG_OFFSET = 0.05
"""What colours are raised by before their logarithm is taken."""
MAX_LOG_STEP = 0.7
"""A logarithm by which a copy misses what lies around: more is another thing there, and not another light."""
BLEND_REACH = 10.0
"""Pixels over which what the rim imposes on copies falls off by a factor of e."""
GRADIENT_WEIGHT, GRADIENT_WINDOW = 8.0, 9
"""How many times a colour difference a difference in mean gradient counts; side of the square it is the mean over."""
FULL_COVER = 0.999
"""Share of a coarse pixel from which on it counts as covered; sums of float32 miss 1."""
SAME_SIDE = 0.1
"""Contrast of the lines between two places from which on they are not of one kind."""


def fill_by_example(
    image: NDArray[np.float32],
    hole: Mask,
    source: Mask,
    *,
    lines_crossed: NDArray[np.float32] | None = None,
    variety: float = 0.0,
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> tuple[NDArray[np.float32], NDArray[np.int64] | None]:
    """`image` [h, w, 3] with `hole` filled by patches that lie wholly in `source`, both [h, w] and disjoint; and what
    each pixel was copied from, as of `copy_patches`.

    What `image` holds in the hole is never looked at; what lies outside both is seen, and not copied. Where the source
    holds no whole patch the hole is filled by Telea's method, and nothing copied. variety: at the coarsest level any
    patch may be taken that is by at most this share less alike than the best; which, `seed` says. lines_crossed: as
    `rectified.measure_lines_crossed` gives it; each line between a place and what is copied to it counts as if all of
    the patch differed by its contrast. device: where patches are compared. The same arguments give the same bytes on a
    processor; a GPU adds votes up in any order.
    """
    made = copy_patches(image, hole, source, lines_crossed=lines_crossed, variety=variety, seed=seed, device=device)
    if made is None:
        return fill_telea(image, hole), None
    return blend_copies(*made, hole), made[1]


def copy_patches(
    image: NDArray[np.float32],
    hole: Mask,
    source: Mask,
    *,
    lines_crossed: NDArray[np.float32] | None = None,
    variety: float = 0.0,
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> tuple[NDArray[np.float32], NDArray[np.int64]] | None:
    """`image` with each pixel of the hole a copy of one of the source, and which one [h, w]: y * w + x.

    None where the source holds no whole patch. Arguments as of `fill_by_example`.
    """
    generator = torch.Generator(device).manual_seed(seed)
    known = source & ~hole
    akin = known if lines_crossed is None else known & _find_akin(lines_crossed, hole)
    levels = 1
    while (
        np.sqrt(hole.sum()) / 2**levels > PATCH and _average_cells(akin, _shrink_size(hole, levels)).sum() > MIN_SOURCE
    ):
        levels += 1
    shown = np.where(hole[..., None], 0, image), GRADIENT_WEIGHT * _measure_gradients(image, ~hole)
    made: tuple[Picture, Origins] | None = None
    for level in reversed(range(levels)):
        size = _shrink_size(hole, level)
        clear = _average_cells(~hole, size)
        means = np.concatenate([_average_cells(part, size) for part in shown], -1)
        picture = torch.from_numpy(means / np.maximum(clear, 1e-6)[..., None]).to(device)
        patches = Patches(
            torch.from_numpy(clear < FULL_COVER).to(device),
            torch.from_numpy(_average_cells(known, size) > FULL_COVER).to(device),
            None if lines_crossed is None else torch.from_numpy(_average_cells(lines_crossed, size)).to(device),
        )
        if len(patches.examples) == 0:
            continue
        cheap = level > 0 or len(patches.examples) * len(patches.touching) < MAX_PAIRS
        everywhere = made is None or (cheap and level >= levels - EXHAUSTIVE_LEVELS)
        if made is None:
            picture, origins = patches.peel(picture, variety, generator), patches.themselves
        else:
            picture, origins = patches.carry_up(picture, *made)
        made = patches.vote(picture, origins, generator, everywhere=everywhere)
    if made is None:
        return None
    picture, origins = (part.cpu().numpy() for part in made)
    return np.where(hole[..., None], picture[..., :3], image).astype(np.float32), origins


def blend_copies(picture: NDArray[np.float32], origins: NDArray[np.int64], hole: Mask) -> NDArray[np.float32]:
    """The copies in the hole with the differences that they have where they come from, joined to what lies around.

    Poisson blending (Perez, Gangnet and Blake 2003, doi:10.1145/882262.882269) of all pieces at once, in logarithms: a
    piece from the light that is copied into shade becomes darker by a factor, and seams between pieces close. Far
    from the rim copies are as they were: the shade around a hole is often that of what was removed. Where the surround
    is another thing (a rim that the mask left) there is nothing to join, and copies stay as they are.
    """
    light = np.log(picture.astype(np.float64) + LOG_OFFSET)
    height, width = hole.shape
    from_y, from_x = origins // width, origins % width
    bend = np.zeros_like(light)
    for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = light[(from_y + dy).clip(0, height - 1), (from_x + dx).clip(0, width - 1)] - light[from_y, from_x]
        # The neighbour knows the same difference from the other side, where it is a copy too.
        y, x = np.mgrid[dy : height + dy, dx : width + dx]
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        y, x = y.clip(0, height - 1), x.clip(0, width - 1)
        back_y, back_x = (from_y[y, x] - dy).clip(0, height - 1), (from_x[y, x] - dx).clip(0, width - 1)
        theirs = light[from_y[y, x], from_x[y, x]] - light[back_y, back_x]
        copy = hole[y, x][..., None]
        off = light[y, x] - light - np.where(copy, (beside + theirs) / 2, beside)
        edge = ~copy & (np.abs(off).max(-1, keepdims=True) > MAX_LOG_STEP)
        bend -= np.where(inside[..., None] & ~edge, off, 0)
    change = span_membrane(np.zeros_like(light), ~hole, bend, reach=BLEND_REACH)
    return np.where(hole[..., None], (np.exp(light + change) - LOG_OFFSET).clip(0, 1), picture).astype(np.float32)


def _find_akin(lines_crossed: NDArray[np.float32], hole: Mask) -> Mask:
    """What lies between the same lines as most of the hole, [h, w]."""
    return np.abs(lines_crossed - np.median(lines_crossed[hole], 0)).max(-1) < SAME_SIDE


def _measure_gradients(image: NDArray[np.float32], known: Mask) -> NDArray[np.float32]:
    """How much the known pixels around each pixel differ from the next one down and to the right, [h, w, 2]."""
    grey = image @ np.array([0.299, 0.587, 0.114], np.float32)
    means = []
    for axis in (0, 1):
        along, both = np.zeros_like(grey), np.zeros_like(grey)
        here = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        next_one = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        both[here] = known[here] & known[next_one]
        along[here] = np.abs(grey[next_one] - grey[here])
        share = np.maximum(cv2.blur(both, (GRADIENT_WINDOW, GRADIENT_WINDOW)), 1e-6)
        means.append(np.where(known, cv2.blur(along * both, (GRADIENT_WINDOW, GRADIENT_WINDOW)) / share, 0))
    return np.stack(means, -1).astype(np.float32)


def _shrink_size(mask: Mask, level: int) -> tuple[int, int]:
    return max(1, mask.shape[0] >> level), max(1, mask.shape[1] >> level)


def _average_cells(values: NDArray[np.generic], size: tuple[int, int]) -> NDArray[np.float32]:
    """Means over the cells of a coarser grid."""
    return np.asarray(cv2.resize(values.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA), np.float32)
