"""What the prior of 128 pixels is and learns from, for the parts that train it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from inpaint3d.contracts.models.artifacts import ImageCorpus, PriorSpec
from inpaint3d.contracts.models.documents import load_yaml
from inpaint3d.contracts.store import load_artifact
from inpaint3d.diffusion.training import Batch
from inpaint3d.stages.diffusion_training.config import Config
from inpaint3d.stages.diffusion_training.pictures import KnownPicture, Picture, corpus_pictures, read_all

CONFIG = Path(__file__).parent / "prior.yaml"
TINY = {"size": 32, "width": 16, "multipliers": [1, 2], "blocks": [1, 1], "attention": [False, True],
        "residual_bands": [0.1, 0.25, 0.6, 1.3]}  # fmt: skip


def config_of(tiny: bool) -> Config:
    """Parameters of `prior.yaml`; tiny: of a network and batches that a test has time for."""
    given = load_yaml(CONFIG)[0]
    if tiny:
        given |= {"prior": given["prior"] | TINY, "batch": 4, "exam": 2, "warm_up": 2, "compiled": False}
    return Config.model_validate(given)


def noise_batch(spec: PriorSpec, count: int) -> Batch:
    """Pictures of noise with a square hole each."""
    chance = torch.Generator().manual_seed(0)
    image = torch.rand(count, 3, spec.size, spec.size, generator=chance) * 2 - 1
    hole = torch.zeros(count, 1, spec.size, spec.size)
    hole[..., spec.size // 4 : 3 * spec.size // 4, spec.size // 4 : 3 * spec.size // 4] = 1
    return Batch(image, hole, torch.ones_like(hole))


def pictures_of(corpora: Sequence[Path]) -> tuple[list[Picture], list[Picture]]:
    """Training and held-out pictures of corpora, decoded; smooth noise where there is none."""
    if not corpora:
        made = _made_up(24)
        return made[6:], made[:6]
    opened = [load_artifact(folder, "image-corpus@1", ImageCorpus) for folder in corpora]
    training = [picture for corpus in opened for picture in corpus_pictures(corpus)]
    held_out = [picture for corpus in opened for picture in corpus_pictures(corpus, "test")]
    return list(read_all(training)), list(read_all(held_out))


def _made_up(count: int) -> list[Picture]:
    """Pictures whose colours change slowly, and nothing unknown in them."""
    rng, nothing = np.random.default_rng(0), np.zeros((96, 96), bool)
    coarse = rng.integers(0, 256, (count, 12, 12, 3)).astype(np.uint8)
    return [
        KnownPicture(f"noise {i}", np.kron(picture, np.ones((8, 8, 1), np.uint8)), nothing, nothing)
        for i, picture in enumerate(coarse)
    ]
