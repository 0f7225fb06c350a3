"""What the pretended GPU refuses is what a GPU refuses."""

import pytest
import torch

from tests.devices.pretended import is_pretended, pretend_cuda


def test_tensors_of_two_devices_do_not_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    with pretend_cuda(monkeypatch):
        here, there = torch.ones(3), torch.ones(3, device="cuda")
        assert (here.device.type, there.device.type, (there * 2).device.type) == ("cpu", "cuda", "cuda")
        for meet in (lambda: here + there, lambda: torch.cat([here, there]), lambda: torch.where(here > 0, there, 0)):
            with pytest.raises(RuntimeError, match="same device"):
                meet()
        with pytest.raises(TypeError, match="cuda"):
            there.numpy()
        torch.testing.assert_close((here.to(there) + there).cpu().numpy(), (2 * here).numpy())


def test_what_a_backward_pass_makes_lies_where_its_graph_does(monkeypatch: pytest.MonkeyPatch) -> None:
    with pretend_cuda(monkeypatch):
        layer = torch.nn.Linear(3, 2).to("cuda")
        layer(torch.ones(4, 3).to("cuda")).square().sum().backward()
        gradient = layer.weight.grad
        assert gradient is not None
        assert is_pretended(layer.weight)
        assert is_pretended(gradient)
        with pytest.raises(RuntimeError, match="same device"):
            layer(torch.ones(4, 3))


def test_a_generator_draws_on_its_own_device(monkeypatch: pytest.MonkeyPatch) -> None:
    with pretend_cuda(monkeypatch):
        generator = torch.Generator("cuda").manual_seed(0)
        assert torch.rand(2, generator=generator, device=generator.device).device.type == "cuda"
        with pytest.raises(RuntimeError, match="generator"):
            torch.rand(2, generator=generator)
