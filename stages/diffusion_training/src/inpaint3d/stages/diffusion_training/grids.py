"""Pictures for a person: what the prior makes of held-out holes, and of the holes that it was trained for."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch

from inpaint3d.diffusion.judging import draw_grid, mean_estimate
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.samplers import inpaint
from inpaint3d.diffusion.training import Batch
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.diffusion_training.pictures import KnownPicture

ROWS = 6


def held_out_grid(path: Path, prior: InpaintingPrior, exam: Batch, steps: int, generator: torch.Generator) -> None:
    """Rows of hole, sample, expectation, truth; pixels that nobody may see are grey in the truth too."""
    image, hole = exam.image[:ROWS], exam.hole[:ROWS]
    sample = inpaint(prior, image, hole, steps=steps, generator=generator)
    write_png(path, draw_grid(image, hole, sample, mean_estimate(prior, image, hole, generator)))


def own_holes_grid(
    path: Path, prior: InpaintingPrior, pictures: Sequence[KnownPicture], steps: int, generator: torch.Generator
) -> None:
    """The capture's own holes: rows of hole, sample, expectation, and the hole again (its truth is not known)."""
    shown = [pictures[i] for i in np.linspace(0, len(pictures) - 1, min(ROWS, len(pictures))).round().astype(int)]
    squares = [_square_round_hole(picture, prior.spec.size) for picture in shown]
    device = next(prior.parameters()).device
    image = torch.from_numpy(np.stack([colour for colour, _ in squares])).to(device).permute(0, 3, 1, 2).contiguous()
    hole = torch.from_numpy(np.stack([unknown for _, unknown in squares])).to(device)[:, None].float()
    sample = inpaint(prior, image, hole, steps=steps, generator=generator)
    write_png(path, draw_grid(image, hole, sample, mean_estimate(prior, image, hole, generator)))


def _square_round_hole(picture: KnownPicture, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(colour, unknown) of the largest square of the frame that has the hole nearest to its middle."""
    height, width = picture.unknown.shape
    side = min(height, width)
    rows, columns = np.nonzero(picture.hole) if picture.hole.any() else np.nonzero(~picture.hole)
    y = int(np.clip(rows.mean() - side / 2, 0, height - side))
    x = int(np.clip(columns.mean() - side / 2, 0, width - side))
    window = np.s_[y : y + side, x : x + side]
    unknown = cv2.resize(picture.unknown[window].astype(np.float32), (size, size), interpolation=cv2.INTER_AREA) > 0
    return cv2.resize(picture.cut(window), (size, size), interpolation=cv2.INTER_AREA), unknown
