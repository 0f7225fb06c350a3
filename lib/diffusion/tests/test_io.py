import pytest
import torch

from inpaint3d.diffusion.io import load_prior, save_prior
from inpaint3d.diffusion.prior import InpaintingPrior


def test_a_prior_comes_back_exactly_and_writes_the_same_bytes(shipped_like, tmp_path) -> None:
    prior = InpaintingPrior(shipped_like, seed=4)
    save_prior(tmp_path / "a.safetensors", prior)
    loaded = load_prior(tmp_path / "a.safetensors", shipped_like)
    assert all(torch.equal(w, loaded.state_dict()[name]) for name, w in prior.state_dict().items())
    assert not any(p.requires_grad for p in loaded.parameters())
    save_prior(tmp_path / "b.safetensors", loaded.to(memory_format=torch.channels_last))
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()


def test_half_precision_halves_the_file_and_keeps_three_digits(shipped_like, tmp_path) -> None:
    prior = InpaintingPrior(shipped_like, seed=4)
    save_prior(tmp_path / "full.safetensors", prior)
    save_prior(tmp_path / "half.safetensors", prior, half=True)
    assert (tmp_path / "half.safetensors").stat().st_size < 0.6 * (tmp_path / "full.safetensors").stat().st_size
    weight = load_prior(tmp_path / "half.safetensors", shipped_like).network.stem.weight
    assert weight.dtype == torch.float32
    torch.testing.assert_close(weight, prior.network.stem.weight, rtol=1e-3, atol=1e-6)


def test_weights_of_another_architecture_are_refused(shipped_like, paper_like, tmp_path) -> None:
    save_prior(tmp_path / "a.safetensors", InpaintingPrior(shipped_like))
    with pytest.raises(ValueError, match="does not hold the weights"):
        load_prior(tmp_path / "a.safetensors", paper_like)
