import pytest
import torch

from inpaint3d.contracts.models.artifacts.prior import PriorSpec
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.unet import EfficientUNet, Level, ResidualBlock


def _net(**changes) -> EfficientUNet:
    plan = {"width": 8, "multipliers": (1, 2), "blocks": (1, 2), "attention": (False, True)}
    return EfficientUNet(3, 3, **(plan | changes))


def test_it_starts_as_zero_so_that_training_starts_from_the_linear_guess() -> None:
    assert torch.equal(_net()(torch.randn(2, 3, 16, 24), torch.zeros(2)), torch.zeros(2, 3, 16, 24))


def test_every_weight_gets_a_gradient_once_the_zeroed_layers_have_moved() -> None:
    torch.manual_seed(0)
    net = _net(packing=2)
    for parameter in net.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    net(torch.randn(2, 3, 32, 32), torch.tensor([3.0, -3.0])).square().mean().backward()
    silent = [name for name, p in net.named_parameters() if p.grad is None or not p.grad.abs().max() > 0]
    assert silent == []


def test_sides_that_do_not_divide_are_refused_with_the_multiple() -> None:
    with pytest.raises(ValueError, match="multiples of 8"):
        _net(packing=2)(torch.zeros(1, 3, 20, 16), torch.zeros(1))
    with pytest.raises(ValueError, match="equal lengths"):
        _net(blocks=(1,))


def test_the_paper_configuration_is_imagens() -> None:
    """256 pixels: dim 128, multipliers 1-2-4-8, residual blocks 2-4-8-8, attention at the coarsest level (D7)."""
    with torch.device("meta"):
        prior = InpaintingPrior(PriorSpec())
    levels, level = [], prior.network.levels
    while isinstance(level, Level):
        levels.append(level)
        level = level.coarser
    assert [level.down.out_channels for level in levels] == [128, 256, 512, 1024]
    assert [len(level.down_blocks) for level in levels] == [2, 4, 8, 8]
    assert [level.down_attention is not None for level in levels] == [False, False, False, True]
    # Downsampling comes before a level's blocks: none of them works at full resolution.
    assert all(level.down.stride == (2, 2) for level in levels)
    assert all(isinstance(block, ResidualBlock) for level in levels for block in level.down_blocks)
    # Imagen says 600 M, with the text attention that this prior has not.
    assert sum(p.numel() for p in prior.parameters()) == 449_338_371
