"""The patches of a picture: those to imitate, those that touch the hole, and what each of the latter is most like."""

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int64
from torch import Tensor

PATCH = 7
"""Side of a patch, pixels; odd."""
MAX_EXAMPLES = 20_000
"""Patches that are tried at most, spread evenly over the source."""
ROUNDS = 4
"""Votes at each level."""
DEPTH_DISCOUNT = 1.3
"""A vote weighs less by this factor for each pixel between its patch and the known ones."""

Picture = Float[Tensor, "h w c"]  # colours, and how lively the surroundings are
Region = Bool[Tensor, "h w"]
Origins = Int64[Tensor, "h w"]  # the pixel that each pixel is a copy of; itself where nothing was copied


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


def _draw_steps(count: int, generator: torch.Generator) -> Int64[Tensor, "2 n"]:
    return torch.randint(-1, 2, (2, count), generator=generator, device=generator.device)


def _unfold(picture: Picture) -> Float[Tensor, "n _"]:
    """The patch around each pixel, channel by channel; the border goes on outside."""
    padded = F.pad(picture.permute(2, 0, 1)[None], (PATCH // 2,) * 4, mode="replicate")
    return F.unfold(padded, PATCH)[0].T


def _grow(region: Region, side: int) -> Region:
    return F.max_pool2d(region[None, None].float(), side, 1, side // 2)[0, 0] > 0
