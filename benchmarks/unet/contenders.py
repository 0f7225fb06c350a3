"""Who is compared: our network and diffusers' of as many parameters."""

from typing import Any

import torch
from diffusers.models.unets.unet_2d import UNet2DModel
from torch import Tensor, nn

from inpaint3d.contracts.models.artifacts import PriorSpec
from inpaint3d.diffusion.prior import InpaintingPrior, input_channels

BATCH = 8
Figures = dict[str, Any]


class Peer(nn.Module):
    """UNet2DModel in the place of an EfficientUNet: channels and log SNR in, channels out."""

    def __init__(self, spec: PriorSpec, width: int, packing: int) -> None:
        super().__init__()
        self.packing = packing
        down = [("Attn" if attention else "") + "DownBlock2D" for attention in spec.attention]
        self.network = UNet2DModel(
            sample_size=spec.size // packing,
            in_channels=input_channels(spec) * packing**2,
            out_channels=3 * packing**2,
            block_out_channels=tuple(width * m for m in spec.multipliers),
            layers_per_block=spec.blocks[0],
            down_block_types=tuple(down),
            up_block_types=tuple(reversed([name.replace("Down", "Up") for name in down])),
            norm_num_groups=8,
            attention_head_dim=32,
        )
        # Like ours, it starts as zero: as a prior, from the linear guess.
        nn.init.zeros_(self.network.conv_out.weight)
        nn.init.zeros_(self.network.conv_out.bias)

    def forward(self, x: Tensor, log_snr: Tensor) -> Tensor:
        x = nn.functional.pixel_unshuffle(x, self.packing)
        # Its embedding is made for timesteps 0 to 1000.
        return nn.functional.pixel_shuffle(self.network(x, (20 - log_snr) * 25).sample, self.packing)


def count(network: nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())


def equal_peer(spec: PriorSpec, packing: int, seed: int = 0) -> Peer:
    """The width that comes nearest to the parameters of ours."""
    with torch.device("meta"):
        wanted = count(InpaintingPrior(spec))
        widths = range(16, 129, 8)
        nearest = min(widths, key=lambda width: abs(count(Peer(spec, width, packing)) - wanted))
    torch.manual_seed(seed)
    return Peer(spec, nearest, packing)


def contenders(spec: PriorSpec) -> dict[str, nn.Module]:
    return {
        "ours": InpaintingPrior(spec).network,
        "peer": equal_peer(spec, 1),
        "peer_packed": equal_peer(spec, spec.packing),
    }
