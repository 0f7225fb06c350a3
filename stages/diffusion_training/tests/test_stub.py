import torch

from inpaint3d.diffusion.io import load_prior
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.stages.diffusion_training.stub import STUB_SPEC, stub_weights


def test_the_stubs_weights_have_the_layout_of_its_spec() -> None:
    expected = {name: tuple(w.shape) for name, w in InpaintingPrior(STUB_SPEC).state_dict().items()}
    assert {name: w.shape for name, w in stub_weights().items()} == expected


def test_the_stub_denoises_towards_the_smooth_fill(tmp_path) -> None:
    from safetensors.numpy import save_file

    save_file(stub_weights(), tmp_path / "weights.safetensors")
    prior = load_prior(tmp_path / "weights.safetensors", STUB_SPEC)
    image, hole = torch.full((1, 3, 16, 16), 0.5), torch.zeros(1, 1, 16, 16)
    hole[..., 4:12, 4:12] = 1
    noise = torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    expected = prior.estimate(noise, torch.ones(1), image, hole).clean
    # At t = 1 the clamp lets 4.5e-5 of z through.
    torch.testing.assert_close(expected, image, rtol=0, atol=1e-3)
