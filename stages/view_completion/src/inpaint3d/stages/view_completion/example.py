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
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int64
from numpy.typing import NDArray
from torch import Tensor

from inpaint3d.diffusion.fill import fill_telea
from inpaint3d.scene.image_io import Mask
from inpaint3d.scene.membrane import span_membrane

PATCH = 7
"""Side of a patch, pixels; odd."""
MAX_EXAMPLES = 20_000
"""Patches that are tried at most, spread evenly over the source."""
MIN_SOURCE = 500
"""Pixels of the source that the coarsest level holds at least."""
EXHAUSTIVE_LEVELS = 2
"""Coarse levels at which every example is tried."""
MAX_PAIRS = 30_000_000
"""Patches to fill times examples beyond which the finest level is no such, unless it is the only one."""
ROUNDS = 4
"""Votes at each level."""
DEPTH_DISCOUNT = 1.3
"""A vote weighs less by this factor for each pixel between its patch and the known ones."""
LOG_OFFSET = 0.05
"""What colours are raised by before their logarithm is taken."""
MAX_LOG_STEP = 0.7
"""A logarithm by which a copy misses what lies around: more is another thing there, and not another light."""
GRADIENT_WEIGHT, GRADIENT_WINDOW = 8.0, 9
"""How many times a colour difference a difference in mean gradient counts; side of the square it is the mean over."""

SAME_SIDE = 0.1
"""Contrast of the lines between two places from which on they are not of one kind."""

Picture = Float[Tensor, "h w c"]  # colours, and how lively the surroundings are
Region = Bool[Tensor, "h w"]
Origins = Int64[Tensor, "h w"]  # the pixel that each pixel is a copy of; itself where nothing was copied


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
    the patch differed by its contrast. device: where patches
    are compared. The same arguments give the same bytes on a processor; a GPU adds votes up in any order.
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
    piece from the light that is copied into shade becomes darker by a factor, and seams between pieces close. Where
    the surround is another thing (a rim that the mask left) there is nothing to join, and copies stay as they are.
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
    nothing = np.zeros(hole.shape)
    change = np.stack([span_membrane(nothing, ~hole, bend[..., channel]) for channel in range(3)], -1)
    return np.where(hole[..., None], (np.exp(light + change) - LOG_OFFSET).clip(0, 1), picture).astype(np.float32)


class Patches:
    """The patches of a picture: those to imitate, and those that touch the hole. Pixels are numbered row by row."""

    def __init__(self, hole: Region, source: Region, lines_crossed: Float[Tensor, "h w 2"] | None = None) -> None:
        self.hole, self.width = hole, hole.shape[1]
        self.lines_crossed = None if lines_crossed is None else lines_crossed.reshape(-1, 2)
        beyond = F.pad((~source)[None, None].float(), (PATCH // 2,) * 4, value=1.0)
        self.usable = F.max_pool2d(beyond, PATCH, 1).flatten() == 0
        usable = torch.nonzero(self.usable)[:, 0]
        count = min(MAX_EXAMPLES, len(usable))
        self.examples = usable[torch.arange(count, device=hole.device) * len(usable) // max(1, count)]
        self.touching = torch.nonzero(_grow(hole, PATCH).flatten())[:, 0]
        self.inside = torch.nonzero(hole.flatten())[:, 0]
        self.themselves = torch.arange(hole.numel(), device=hole.device).view_as(hole)
        depth = cv2.distanceTransform(hole.cpu().numpy().astype(np.uint8), cv2.DIST_L2, 3)
        self.trust = DEPTH_DISCOUNT ** -torch.from_numpy(depth).to(hole.device).flatten()[self.touching]

    def find_nearest(
        self,
        picture: Picture,
        at: Int64[Tensor, " n"],
        valid: Region | None = None,
        variety: float = 0.0,
        generator: torch.Generator | None = None,
    ) -> tuple[Int64[Tensor, " n"], Float[Tensor, " n"]]:
        """The example most like the patch around each pixel of `at`, and their mean squared difference.

        Only `valid` pixels of the patches are compared; None: all. With variety every difference counts as up to that
        share more, by chance.
        """
        flat, channels = _unfold(picture), picture.shape[-1]
        examples, asked = flat[self.examples], flat[at]
        weight = torch.ones_like(asked)
        if valid is not None:
            weight = _unfold(valid[..., None].float())[at].repeat(1, channels)
        squares = examples.square()
        found, costs = [], []
        for part, q, w in zip(at.split(1024), (asked * weight).split(1024), weight.split(1024), strict=True):
            own = squares.sum(1)[None] if valid is None else w @ squares.T
            apart = own - 2 * q @ examples.T + q.square().sum(1, keepdim=True)
            apart = apart + PATCH**2 * self._cross(part[:, None], self.examples[None])
            if variety:
                chance = torch.rand(apart.shape, generator=generator, device=apart.device)
                apart = apart.clamp(min=0) * (1 + variety * chance)
            cost, index = apart.min(1)
            found.append(self.examples[index])
            costs.append(cost.clamp(min=0) / w.sum(1).clamp(min=1))
        return torch.cat(found), torch.cat(costs)

    def find_nearby(
        self, picture: Picture, origins: Origins, generator: torch.Generator
    ) -> tuple[Int64[Tensor, " n"], Float[Tensor, " n"]]:
        """For each patch that touches the hole the best of what continues its own or a neighbour's origin, or lies a
        pixel beside such a one; and their mean squared difference.
        """
        flat = _unfold(picture)
        asked = flat[self.touching]
        height, width = self.hole.shape
        y, x = self.touching // width, self.touching % width
        best = self.touching.clone()
        least = torch.full((len(best),), torch.inf, device=best.device)
        for dy, dx in torch.cartesian_prod(torch.arange(-1, 2), torch.arange(-1, 2)):
            near_y, near_x = (y + dy).clamp(0, height - 1), (x + dx).clamp(0, width - 1)
            origin = origins[near_y, near_x]
            for aside in (torch.zeros(2, len(y), dtype=torch.long, device=y.device), _draw_steps(len(y), generator)):
                from_y = origin // width - (near_y - y) + aside[0]
                from_x = origin % width - (near_x - x) + aside[1]
                inside = (from_y >= 0) & (from_y < height) & (from_x >= 0) & (from_x < width)
                tried = from_y.clamp(0, height - 1) * width + from_x.clamp(0, width - 1)
                cost = (flat[tried] - asked).square().mean(1)
                cost = cost + self._cross(self.touching, tried) / picture.shape[-1]
                better = inside & self.usable[tried] & (cost < least)
                best, least = torch.where(better, tried, best), torch.where(better, cost, least)
        # Where no neighbour leads to an example, every example is asked.
        if (lost := torch.nonzero(least.isinf())[:, 0]).numel():
            best[lost], least[lost] = self.find_nearest(picture, self.touching[lost])
        return best, least

    def _cross(self, at: Tensor, examples: Tensor) -> Tensor | float:
        """Squared contrast of the lines between places and what is copied to them."""
        if self.lines_crossed is None:
            return 0.0
        return (self.lines_crossed[at] - self.lines_crossed[examples]).square().sum(-1)

    def peel(self, picture: Picture, variety: float, generator: torch.Generator) -> Picture:
        """The hole filled from its border inwards, each pixel by the middle of a most alike example."""
        picture, missing = picture.clone(), self.hole.clone()
        flat = picture.view(-1, picture.shape[-1])
        while missing.any():
            border = missing & _grow(~missing, 3)
            at = torch.nonzero(border.flatten())[:, 0]
            flat[at] = flat[self.find_nearest(picture, at, ~missing, variety, generator)[0]]
            missing &= ~border
        return picture

    def vote(
        self, picture: Picture, origins: Origins, generator: torch.Generator, *, everywhere: bool
    ) -> tuple[Picture, Origins]:
        """After some rounds of votes: the picture, each pixel of the hole a copy, and where all were copied from.

        everywhere: every example is tried, and not only those that continue `origins`.
        """
        for turn in range(ROUNDS + 1):
            best, cost = (
                self.find_nearest(picture, self.touching)
                if everywhere
                else self.find_nearby(picture, origins, generator)
            )
            origins = self.themselves.flatten().index_copy(0, self.touching, best).view_as(self.hole)
            if turn < ROUNDS:
                picture = self._average_votes(picture, best, cost)
        return self._apply_copies(picture, origins), origins

    def carry_up(self, picture: Picture, coarse: Picture, coarse_origins: Origins) -> tuple[Picture, Origins]:
        """A finer level's first guess: each pixel a copy of what lies where its coarse pixel came from; and whence."""
        (h, w), (ch, cw) = self.hole.shape, coarse_origins.shape
        rows, columns = (torch.arange(count, device=picture.device) for count in (h, w))
        y, x = torch.meshgrid(rows, columns, indexing="ij")
        cy, cx = y * ch // h, x * cw // w
        origin = coarse_origins[cy, cx]
        there_y = (origin // cw * h // ch + y - cy * h // ch).clamp(0, h - 1)
        there_x = (origin % cw * w // cw + x - cx * w // cw).clamp(0, w - 1)
        origins = there_y * w + there_x
        # A copy of the hole itself, where sizes do not divide, is no example: the coarse colour stands in.
        guess = torch.where(
            self.hole.flatten()[origins][..., None], coarse[cy, cx], self._apply_copies(picture, origins)
        )
        return torch.where(self.hole[..., None], guess, picture), origins

    def _apply_copies(self, picture: Picture, origins: Origins) -> Picture:
        flat = picture.reshape(-1, picture.shape[-1])
        return torch.where(self.hole[..., None], flat[origins.flatten()].view_as(picture), picture)

    def _average_votes(self, picture: Picture, best: Int64[Tensor, " n"], cost: Float[Tensor, " n"]) -> Picture:
        """Each pixel of the hole as the patches over it would have it, every one of them its example."""
        # The kernel is as wide as most patches are off (Wexler et al., sec. 3.2).
        width = torch.quantile(cost, 0.75).clamp(min=1e-8)
        weight = (torch.exp(-cost / (2 * width)) * self.trust).clamp(min=1e-12)
        channels = picture.shape[-1]
        votes = _unfold(picture)[best] * weight[:, None]
        height, reach = len(self.hole), PATCH // 2
        sums, total = picture.new_zeros(height * self.width, channels), picture.new_zeros(height * self.width)
        row, column = self.touching // self.width, self.touching % self.width
        for index, values in enumerate(votes.view(len(best), channels, -1).unbind(2)):
            y, x = row + index // PATCH - reach, column + index % PATCH - reach
            there = (y >= 0) & (y < height) & (x >= 0) & (x < self.width)
            at = (y * self.width + x)[there]
            sums.index_add_(0, at, values[there])
            total.index_add_(0, at, weight[there])
        flat = picture.reshape(-1, channels).clone()
        flat[self.inside] = sums[self.inside] / total[self.inside, None]
        return flat.view_as(picture)


FULL_COVER = 0.999
"""Share of a coarse pixel from which on it counts as covered; sums of float32 miss 1."""


def _find_akin(lines_crossed: NDArray[np.float32], hole: Mask) -> Mask:
    """What lies between the same lines as most of the hole, [h, w]."""
    return np.abs(lines_crossed - np.median(lines_crossed[hole], 0)).max(-1) < SAME_SIDE


def _draw_steps(count: int, generator: torch.Generator) -> Int64[Tensor, "2 n"]:
    return torch.randint(-1, 2, (2, count), generator=generator, device=generator.device)


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


def _unfold(picture: Picture) -> Float[Tensor, "n _"]:
    """The patch around each pixel, channel by channel; the border goes on outside."""
    padded = F.pad(picture.permute(2, 0, 1)[None], (PATCH // 2,) * 4, mode="replicate")
    return F.unfold(padded, PATCH)[0].T


def _grow(region: Region, side: int) -> Region:
    return F.max_pool2d(region[None, None].float(), side, 1, side // 2)[0, 0] > 0


def _shrink_size(mask: Mask, level: int) -> tuple[int, int]:
    return max(1, mask.shape[0] >> level), max(1, mask.shape[1] >> level)


def _count_cells(mask: Mask, level: int) -> float:
    """How many cells of a coarser level the mask covers."""
    return float(_average_cells(mask, _shrink_size(mask, level)).sum())


def _average_cells(values: NDArray[np.generic], size: tuple[int, int]) -> NDArray[np.float32]:
    """Means over the cells of a coarser grid."""
    return np.asarray(cv2.resize(values.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA), np.float32)
