"""The Efficient UNet of Imagen (arXiv:2205.11487, appendix B): a denoiser that spends its work at low resolution.

Every level halves the resolution *before* its convolutions and doubles it *after* them, and skip connections are scaled
by 1/sqrt(2). Unlike Imagen's there is no text: the log signal-to-noise ratio alone modulates the blocks.
"""

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

SKIP_SCALE = 1 / math.sqrt(2)
HEAD_WIDTH = 32
EMBEDDING = 128


def _make_norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(math.gcd(channels, 32) if channels < 64 else 32, channels)


def _zero(layer: nn.Conv2d) -> nn.Conv2d:
    """A layer that starts as "adds nothing", so that a deep network starts as the identity."""
    nn.init.zeros_(layer.weight)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    return layer


class NoiseEmbedding(nn.Module):
    """log SNR [b] -> features [b, 4 * EMBEDDING]: sinusoids of it and a two-layer network."""

    frequencies: Tensor

    def __init__(self) -> None:
        super().__init__()
        # log SNR lies within +-20: periods from 0.6 (tells neighbouring steps apart) to 6000 (nearly linear).
        self.register_buffer("frequencies", torch.logspace(1, -3, EMBEDDING // 2), persistent=False)
        self.network = nn.Sequential(
            nn.Linear(EMBEDDING, 4 * EMBEDDING), nn.SiLU(), nn.Linear(4 * EMBEDDING, 4 * EMBEDDING), nn.SiLU()
        )

    def forward(self, log_snr: Float[Tensor, "b"]) -> Float[Tensor, "b e"]:
        angles = log_snr[:, None] * self.frequencies
        return self.network(torch.cat([torch.sin(angles), torch.cos(angles)], dim=-1))


class ResidualBlock(nn.Module):
    """Norm, swish, convolution, twice; the second norm is scaled and shifted by the noise level (Imagen fig. A.27)."""

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        self.norm_in, self.norm_out = _make_norm(before), _make_norm(after)
        self.conv_in = nn.Conv2d(before, after, 3, padding=1)
        self.conv_out = _zero(nn.Conv2d(after, after, 3, padding=1))
        self.modulation = nn.Linear(4 * EMBEDDING, 2 * after)
        self.shortcut = nn.Conv2d(before, after, 1) if before != after else nn.Identity()

    def forward(self, x: Float[Tensor, "b c h w"], noise: Float[Tensor, "b e"]) -> Float[Tensor, "b d h w"]:
        hidden = self.conv_in(F.silu(self.norm_in(x)))
        scale, shift = self.modulation(noise)[:, :, None, None].chunk(2, dim=1)
        hidden = self.conv_out(F.silu(torch.addcmul(shift, self.norm_out(hidden), 1 + scale)))
        return self.shortcut(x) + hidden


class SelfAttention(nn.Module):
    """Every place looks at every other (arXiv:1706.03762): what carries texture across a large hole."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.heads = max(1, channels // HEAD_WIDTH)
        self.norm = _make_norm(channels)
        self.project_in = nn.Conv2d(channels, 3 * channels, 1)
        self.project_out = _zero(nn.Conv2d(channels, channels, 1))

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        b, c, h, w = x.shape
        qkv = self.project_in(self.norm(x)).reshape(b, 3, self.heads, c // self.heads, h * w)
        q, k, v = qkv.transpose(-1, -2).unbind(1)
        mixed = F.scaled_dot_product_attention(q, k, v).transpose(-1, -2).reshape(b, c, h, w)
        return x + self.project_out(mixed)


class Level(nn.Module):
    """One resolution: blocks going down, everything coarser in between, blocks going up."""

    def __init__(self, outer: int, inner: int, blocks: int, attention: bool, coarser: nn.Module | None) -> None:
        super().__init__()
        self.down = nn.Conv2d(outer, inner, 3, stride=2, padding=1)
        self.down_blocks = nn.ModuleList(ResidualBlock(inner, inner) for _ in range(blocks))
        self.down_attention = SelfAttention(inner) if attention else None
        self.coarser = coarser
        self.up_blocks = nn.ModuleList(ResidualBlock(2 * inner if i == 0 else inner, inner) for i in range(blocks))
        self.up_attention = SelfAttention(inner) if attention else None
        # Four times the channels, then pixel shuffle: as good as upsampling and convolving, at a quarter of the work.
        self.up = nn.Conv2d(inner, 4 * outer, 1)

    def forward(self, x: Float[Tensor, "b c h w"], noise: Float[Tensor, "b e"]) -> Float[Tensor, "b c h w"]:
        x = self.down(x)
        for block in self.down_blocks:
            x = block(x, noise)
        if self.down_attention is not None:
            x = self.down_attention(x)
        skip = x * SKIP_SCALE
        if self.coarser is not None:
            x = self.coarser(x, noise)
        x = torch.cat([x, skip], dim=1)
        for block in self.up_blocks:
            x = block(x, noise)
        if self.up_attention is not None:
            x = self.up_attention(x)
        return F.pixel_shuffle(self.up(x), 2)


class EfficientUNet(nn.Module):
    """Images with `inputs` channels and their log SNR -> images with `outputs` channels.

    Height and width must be multiples of `packing * 2 ** len(multipliers)`. Packing folds pixels into channels first
    (space to depth), so that a patch costs what one `packing` times smaller does.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        width: int,
        multipliers: Sequence[int],
        blocks: Sequence[int],
        attention: Sequence[bool],
        packing: int = 1,
    ) -> None:
        super().__init__()
        if not len(multipliers) == len(blocks) == len(attention):
            raise ValueError(
                f"multipliers {tuple(multipliers)}, blocks {tuple(blocks)} and attention {tuple(attention)} "
                "describe the same levels; give them equal lengths"
            )
        self.packing = packing
        self.stride = packing * 2 ** len(multipliers)
        self.noise = NoiseEmbedding()
        self.stem = nn.Conv2d(inputs * packing**2, width, 3, padding=1)
        widths = [width, *(width * m for m in multipliers)]
        level: nn.Module | None = None
        for i in reversed(range(len(multipliers))):
            level = Level(widths[i], widths[i + 1], blocks[i], attention[i], level)
        self.levels = level
        self.norm = _make_norm(width)
        self.head = _zero(nn.Conv2d(width, outputs * packing**2, 3, padding=1))

    def forward(self, x: Float[Tensor, "b c h w"], log_snr: Float[Tensor, "b"]) -> Float[Tensor, "b o h w"]:
        if x.shape[-1] % self.stride or x.shape[-2] % self.stride:
            raise ValueError(f"pictures are {x.shape[-1]}x{x.shape[-2]}; sides must be multiples of {self.stride}")
        noise = self.noise(log_snr)
        stem = self.stem(F.pixel_unshuffle(x, self.packing))
        x = stem if self.levels is None else (self.levels(stem, noise) + stem) * SKIP_SCALE
        return F.pixel_shuffle(self.head(F.silu(self.norm(x))), self.packing)
