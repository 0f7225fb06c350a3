"""Tiny priors to run the tests on."""

import pytest
import torch

from inpaint3d.contracts.models.artifacts.prior import PriorSpec

_TINY = {"size": 16, "width": 8, "multipliers": (1, 2), "blocks": (1, 1), "attention": (False, True)}
_SHIPPED = {
    "residual_bands": (0.3,),
    "residual_colours": (1.0, 1.0, 1.0),
    "packing": 2,
    "condition": "mask-channel",
    "known": "clean",
    "loss_region": "hole",
    "prediction": "residual",
}


@pytest.fixture
def paper_like() -> PriorSpec:
    """The paper's conditioning, at 16 pixels."""
    return PriorSpec.model_validate(_TINY)


@pytest.fixture
def shipped_like() -> PriorSpec:
    """The default conditioning, at 16 pixels. Untrained, it is the exact denoiser of N(fill, 0.3^2)."""
    return PriorSpec.model_validate(_TINY | _SHIPPED)


@pytest.fixture
def picture() -> torch.Tensor:
    """Two smooth pictures [2, 3, 16, 16] in [-1, 1]."""
    coarse = torch.rand(2, 3, 4, 4, generator=torch.Generator().manual_seed(7)) * 2 - 1
    return torch.nn.functional.interpolate(coarse, size=16, mode="bilinear")


@pytest.fixture
def hole() -> torch.Tensor:
    """A box in the middle of each picture [2, 1, 16, 16]."""
    mask = torch.zeros(2, 1, 16, 16)
    mask[:, :, 5:11, 4:12] = 1
    return mask
