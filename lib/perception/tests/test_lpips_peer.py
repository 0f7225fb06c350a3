"""LPIPS against torchmetrics' implementation, which brings upstream's heads in files of its own."""

import numpy as np
import pytest
import torch
from torchmetrics.functional.image import lpips as peer

from inpaint3d.perception import lpips


def build_peer(network: lpips.Network, ours: lpips.Lpips) -> torch.nn.Module:
    """torchmetrics' network with its own heads, and the body's weights from our file: it would download them."""
    theirs = peer._LPIPS(net=network, pnet_rand=True)
    convolutions = [m for m in theirs.net.modules() if isinstance(m, torch.nn.Conv2d)]
    assert len(convolutions) == len(ours.layers)
    with torch.no_grad():
        for convolution, layer in zip(convolutions, ours.layers, strict=True):
            convolution.weight.copy_(layer.weight)
            convolution.bias.copy_(layer.bias)
    return theirs


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_the_heads_are_those_that_torchmetrics_brings(network):
    ours, theirs = lpips.load(network), peer._LPIPS(net=network, pnet_rand=True)
    for head, line in zip(ours.heads, theirs.lins, strict=True):
        torch.testing.assert_close(head, line.model[-1].weight, rtol=0, atol=0)


@pytest.mark.parametrize("network", ["alex", "vgg"])
@pytest.mark.parametrize("kind", ["noise", "constant", "identical", "black"])
def test_distances_are_torchmetrics(network, kind):
    rng = np.random.default_rng(1)
    truth = rng.random((64, 70, 3), dtype=np.float32)
    picture = {
        "noise": rng.random((64, 70, 3), dtype=np.float32),
        "constant": np.full_like(truth, 0.5),
        "identical": truth,
        "black": np.zeros_like(truth),
    }[kind]
    ours = lpips.load(network)
    a, b = (torch.from_numpy(p.transpose(2, 0, 1)[None] * 2 - 1) for p in (picture, truth))
    with torch.no_grad():
        theirs = float(build_peer(network, ours)(a, b))
    assert ours.distance(picture, truth) == pytest.approx(theirs, rel=1e-5, abs=1e-7)
