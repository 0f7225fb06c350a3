"""A short training of two parts a step, on whatever ranks torchrun starts: checkpoint and losses go to argv[1]."""

import sys
from pathlib import Path

import torch

from inpaint3d.contracts.models.artifacts.prior import PriorSpec
from inpaint3d.diffusion.masks import random_masks
from inpaint3d.diffusion.parallel import join_ranks, leave_ranks, own_parts, rank
from inpaint3d.diffusion.training import Batch, begin, denoising_loss, save_checkpoint, step_generators, train_step

PARTS, STEPS = 2, 4


def learn(out: Path) -> list[float]:
    spec = PriorSpec(size=16, width=8, multipliers=(1, 2), blocks=(1, 1), attention=(False, True))
    state = begin(spec, seed=0)
    losses = []
    for step in range(STEPS):
        parts = []
        for part in own_parts(PARTS):
            rng, generator = step_generators(0, step, part)
            image = torch.from_numpy(rng.uniform(-1, 1, (2, 3, 16, 16))).float()
            hole = torch.from_numpy(random_masks(2, 16, rng)).float()[:, None]
            batch = Batch(image, hole, torch.ones_like(hole))
            parts.append(lambda prior, batch=batch, generator=generator: denoising_loss(prior, batch, generator))
        losses.append(train_step(state, *parts, learning_rate=1e-3))
    if rank() == 0:
        save_checkpoint(out / "checkpoint.safetensors", state)
        (out / "losses.txt").write_text("\n".join(map(repr, losses)))
    return losses


if __name__ == "__main__":
    torch.set_num_threads(1)
    join_ranks()
    learn(Path(sys.argv[1]))
    leave_ranks()
