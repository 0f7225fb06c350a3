from pathlib import Path

import pytest
import torch

from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.runtimes import export_onnx, load_onnx


@pytest.fixture(params=["paper_like", "shipped_like"])
def prior(request) -> InpaintingPrior:
    """A prior whose zero-started layers have moved, as after training."""
    prior = InpaintingPrior(request.getfixturevalue(request.param), seed=3)
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in prior.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, generator=generator))
    return prior.requires_grad_(False)


# What the exporter uses of torch and onnxscript is old to torch itself.
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_the_exported_network_is_the_network(prior, picture, hole, tmp_path: Path) -> None:
    export_onnx(tmp_path / "network.onnx", prior)
    exported = load_onnx(tmp_path / "network.onnx", prior.spec)
    assert isinstance(exported, Denoiser)
    generator = torch.Generator().manual_seed(0)
    z, fill = (torch.randn(picture.shape, generator=generator) for _ in range(2))
    for count in (1, 2):
        for guidance in (1.0, 3.0):
            here, there = (
                p.predict_noise(z[:count], torch.tensor([0.2, 0.9])[:count], picture[:count], hole[:count],
                                guidance=guidance, noise_fill=fill[:count])
                for p in (prior, exported)
            )  # fmt: skip
            # Single precision, sums in another order, through some twenty layers; values are of the order of 1.
            torch.testing.assert_close(there, here, rtol=1e-3, atol=1e-4)
            assert here.abs().max() > 0.5


def test_a_file_that_is_no_network_is_named(shipped_like, tmp_path: Path) -> None:
    (tmp_path / "network.onnx").write_bytes(b"not ONNX")
    with pytest.raises(ValueError, match=r"network\.onnx is not a network.*export it again"):
        load_onnx(tmp_path / "network.onnx", shipped_like)
