"""A hole in one picture, filled by example: coarse to fine, each of its patches becomes like one of the known pixels.

Space-time completion (Wexler, Shechtman and Irani 2007, doi:10.1109/TPAMI.2007.60) on one picture: votes of overlapping
patches, weighted by likeness and by how near the known pixels are. The nearest patch is found by trying all of them: a
hole that no photo shows is small. The coarsest level is peeled from outside as by Efros and Leung (1999,
doi:10.1109/ICCV.1999.790383); from level to level goes where each pixel came from, not its colour, so that nothing
blurs (as in PatchMatch, Barnes et al. 2009, doi:10.1145/1531326.1531330).
"""

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int64
from numpy.typing import NDArray
from torch import Tensor

from inpaint3d.stages.joint_optimization.scene import Mask

PATCH = 7
"""Side of a patch, pixels; odd."""
EXAMPLES = 20_000
"""Patches that are tried at most, spread evenly over the source."""
LEAST_SOURCE = 500
"""Pixels of the source that the coarsest level holds at least."""
ROUNDS, FINEST_ROUNDS = 5, 3
FORGETTING = 1.3
"""A vote weighs less by this factor for each pixel between its patch and the known ones."""

Picture = Float[Tensor, "h w 3"]
Region = Bool[Tensor, "h w"]
Origins = Int64[Tensor, "h w"]


def synthesised(
    image: NDArray[np.float32], hole: Mask, source: Mask, *, variety: float = 0.0, seed: int = 0
) -> NDArray[np.float32]:
    """`image` [h, w, 3] with `hole` filled from patches that lie wholly in `source`; both [h, w] and disjoint.

    What `image` holds in the hole is never looked at; what lies outside both is seen, and not copied. Where the source
    holds no whole patch the hole is filled by Telea's method. variety: at the coarsest level any patch may be taken
    that is by at most this share less alike than the best; which, `seed` says. The same arguments give the same bytes.
    """
    generator = torch.Generator().manual_seed(seed)
    known = source & ~hole
    levels = 1
    while np.sqrt(hole.sum()) / 2**levels > PATCH and _area(known, _size(hole, levels)).sum() > LEAST_SOURCE:
        levels += 1
    made: tuple[Picture, Origins] | None = None
    for level in reversed(range(levels)):
        size = _size(hole, level)
        clear = _area(~hole, size)
        blank = torch.from_numpy(clear < WHOLE)
        start = _area(np.where(hole[..., None], 0, image), size) / np.maximum(clear, 1e-6)[..., None]
        patches = Patches(blank, torch.from_numpy(_area(known, size) > WHOLE))
        if len(patches.examples) == 0:
            continue
        picture = torch.from_numpy(start)
        picture = patches.peeled(picture, variety, generator) if made is None else _carried_up(picture, blank, *made)
        made = patches.settled(picture, FINEST_ROUNDS if level == 0 else ROUNDS)
    if made is None:
        return telea(image, hole)
    return np.where(hole[..., None], made[0].numpy(), image).astype(np.float32)


def telea(image: NDArray[np.float32], hole: Mask, radius: float = 3.0) -> NDArray[np.float32]:
    """`image` [h, w, 3] in [0, 1] with `hole` filled smoothly (Telea 2004); radius: pixels that it looks around at."""
    codes = np.round(image.clip(0, 1) * 255).astype(np.uint8)
    made = cv2.inpaint(codes, hole.astype(np.uint8), radius, cv2.INPAINT_TELEA)
    return np.where(hole[..., None], made.astype(np.float32) / 255, image).astype(np.float32)


class Patches:
    """The patches of a picture: those to imitate, and those that touch the hole. Pixels are numbered row by row."""

    def __init__(self, hole: Region, source: Region) -> None:
        self.hole, self.width = hole, hole.shape[1]
        whole = -F.max_pool2d(-F.pad(source[None, None].float(), (PATCH // 2,) * 4), PATCH, 1)
        usable = torch.nonzero(whole.flatten() > 0)[:, 0]
        count = min(EXAMPLES, len(usable))
        self.examples = usable[torch.arange(count) * len(usable) // max(1, count)]
        self.touching = torch.nonzero(_grown(hole, PATCH).flatten())[:, 0]
        self.inside = torch.nonzero(hole.flatten())[:, 0]
        depth = cv2.distanceTransform(hole.numpy().astype(np.uint8), cv2.DIST_L2, 3)
        self.trust = FORGETTING ** -torch.from_numpy(depth).flatten()[self.touching]

    def nearest(
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
        flat = _unfolded(picture)
        examples, asked = flat[self.examples], flat[at]
        weight = torch.ones_like(asked) if valid is None else _unfolded(valid[..., None].float())[at].repeat(1, 3)
        squares = examples.square()
        found, costs = [], []
        for q, w in zip((asked * weight).split(1024), weight.split(1024), strict=True):
            own = squares.sum(1)[None] if valid is None else w @ squares.T
            apart = own - 2 * q @ examples.T + q.square().sum(1, keepdim=True)
            if variety:
                apart = apart.clamp(min=0) * (1 + variety * torch.rand(apart.shape, generator=generator))
            cost, index = apart.min(1)
            found.append(self.examples[index])
            costs.append(cost.clamp(min=0) / w.sum(1).clamp(min=1))
        return torch.cat(found), torch.cat(costs)

    def peeled(self, picture: Picture, variety: float, generator: torch.Generator) -> Picture:
        """The hole filled from its border inwards, each pixel by the middle of a most alike example."""
        picture, missing = picture.clone(), self.hole.clone()
        flat = picture.view(-1, 3)
        while missing.any():
            border = missing & _grown(~missing, 3)
            at = torch.nonzero(border.flatten())[:, 0]
            flat[at] = flat[self.nearest(picture, at, ~missing, variety, generator)[0]]
            missing &= ~border
        return picture

    def settled(self, picture: Picture, rounds: int) -> tuple[Picture, Origins]:
        """After some rounds of votes: the picture, and the pixel that each pixel of the hole is a copy of."""
        for _ in range(rounds):
            picture = self._voted(picture)
        origins = torch.arange(self.hole.numel())
        origins[self.inside] = self.nearest(picture, self.inside)[0]
        return picture.reshape(-1, 3)[origins].view_as(picture), origins.view_as(self.hole)

    def _voted(self, picture: Picture) -> Picture:
        """Each pixel of the hole as the patches over it would have it, every one of them its nearest example."""
        best, cost = self.nearest(picture, self.touching)
        # The kernel is as wide as most patches are off (Wexler et al., sec. 3.2).
        width = torch.quantile(cost, 0.75).clamp(min=1e-8)
        weight = (torch.exp(-cost / (2 * width)) * self.trust).clamp(min=1e-12)
        votes = _unfolded(picture)[best] * weight[:, None]
        height, reach = len(self.hole), PATCH // 2
        sums, total = picture.new_zeros(height * self.width, 3), picture.new_zeros(height * self.width)
        row, column = self.touching // self.width, self.touching % self.width
        for index, colours in enumerate(votes.view(len(best), 3, -1).unbind(2)):
            y, x = row + index // PATCH - reach, column + index % PATCH - reach
            there = (y >= 0) & (y < height) & (x >= 0) & (x < self.width)
            at = (y * self.width + x)[there]
            sums.index_add_(0, at, colours[there])
            total.index_add_(0, at, weight[there])
        flat = picture.reshape(-1, 3).clone()
        flat[self.inside] = sums[self.inside] / total[self.inside, None]
        return flat.view_as(picture)


WHOLE = 0.999
"""Share of a coarse pixel from which on it counts as covered; sums of float32 miss 1."""


def _carried_up(picture: Picture, hole: Region, coarse: Picture, origins: Origins) -> Picture:
    """A finer level's first guess: each pixel a copy of what lies where its coarse pixel came from."""
    (h, w), (ch, cw) = hole.shape, origins.shape
    y, x = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    cy, cx = y * ch // h, x * cw // w
    origin = origins[cy, cx]
    there_y = (origin // cw * h // ch + y - cy * h // ch).clamp(0, h - 1)
    there_x = (origin % cw * w // cw + x - cx * w // cw).clamp(0, w - 1)
    # A copy of the hole itself, where sizes do not divide, is no example: the coarse colour stands in.
    copied = torch.where(hole[there_y, there_x][..., None], coarse[cy, cx], picture[there_y, there_x])
    return torch.where(hole[..., None], copied, picture)


def _unfolded(picture: Float[Tensor, "h w c"]) -> Float[Tensor, "n _"]:
    """The patch around each pixel, channel by channel; the border goes on outside."""
    padded = F.pad(picture.permute(2, 0, 1)[None], (PATCH // 2,) * 4, mode="replicate")
    return F.unfold(padded, PATCH)[0].T


def _grown(region: Region, side: int) -> Region:
    return F.max_pool2d(region[None, None].float(), side, 1, side // 2)[0, 0] > 0


def _size(mask: Mask, level: int) -> tuple[int, int]:
    return max(1, mask.shape[0] >> level), max(1, mask.shape[1] >> level)


def _area(values: NDArray[np.generic], size: tuple[int, int]) -> NDArray[np.float32]:
    """Means over the cells of a coarser grid."""
    return np.asarray(cv2.resize(values.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA), np.float32)
