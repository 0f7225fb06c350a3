"""A prior that needs no training: does what fills a hole look like something that the scene shows elsewhere?

Features of VGG16 inside the hole are matched with those of known regions, in colour and in the first three taps.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from inpaint3d.perception.lpips import load

TAPS = 3
REACH = (0, 2, 7, 20)
"""Pixels that a feature of colour, conv1_2, conv2_2, conv3_3 looks at around its own."""

Cells = list[Float[Tensor, "n _"]]
Image = Float[Tensor, "1 3 h w"]
Region = Bool[Tensor, "h w"]


def cells(image: Image, region: Region, *, whole: bool) -> Cells:
    """Features of the cells of `region`, by depth: colours and three taps, each [n, channels].

    image is in [-1, 1]. whole: only cells all of whose reach lies in the region (references must not look into a
    hole); else every cell that touches it.
    """
    found: Cells = []
    for features, reach in zip([image, *load("vgg", image.device).taps(image, TAPS)], REACH, strict=True):
        chosen = region[None, None].float()
        if whole:
            chosen = -F.max_pool2d(-F.pad(chosen, (reach,) * 4, value=1.0), 2 * reach + 1, 1)
        stride = image.shape[-1] // features.shape[-1]
        chosen = -F.max_pool2d(-chosen, stride) if whole else F.max_pool2d(chosen, stride)
        found.append(features[0].permute(1, 2, 0)[chosen[0, 0] > 0])
    return found


def nearest_mismatch(made: Cells, references: Cells) -> Float[Tensor, ""]:
    """Mean distance of each made feature to its nearest reference (arXiv:2203.13215, eq. 2), summed over the depths.

    Cosine distance for taps, as there; squared distance for colours, whose length means something. Depths with no
    reference are left out.
    """
    total = made[0].new_zeros(())
    for depth, (a, b) in enumerate(zip(made, references, strict=True)):
        if not (len(a) and len(b)):
            continue
        if depth == 0:
            apart = torch.cdist(a, b).square() / a.shape[1]
        else:
            apart = 1 - F.normalize(a, dim=1) @ F.normalize(b, dim=1).T
        total = total + apart.min(1).values.mean()
    return total


def sliced_mismatch(made: Cells, references: Cells, generator: torch.Generator, slices: int = 32) -> Float[Tensor, ""]:
    """Sliced Wasserstein distance of the two sets of features (arXiv:2006.07229, eq. 3), summed over the depths.

    Along each of `slices` random directions both sets are sorted, and quantiles compared. Depths with no reference are
    left out; features are measured in the references' own spread.
    """
    total = made[0].new_zeros(())
    for a, b in zip(made, references, strict=True):
        if not (len(a) and len(b)):
            continue
        drawn = torch.randn(a.shape[1], slices, generator=generator, device=generator.device)
        directions = F.normalize(drawn, dim=0).to(a)
        along_a, along_b = ((x @ directions).sort(0).values for x in (a, b))
        at = (torch.arange(len(a)) + 0.5) / len(a) * len(b)
        there = along_b[at.long().to(a.device).clamp(max=len(b) - 1)]
        # In units of the references' spread, so that no depth outweighs the others.
        scale = along_b.var(0, correction=0).mean().clamp(min=1e-4)
        total = total + (along_a - there).square().mean() / scale
    return total


def join_cells(parts: Sequence[Cells]) -> Cells:
    """The cells of several pictures, depth by depth."""
    return [torch.cat(depth) for depth in zip(*parts, strict=True)]
