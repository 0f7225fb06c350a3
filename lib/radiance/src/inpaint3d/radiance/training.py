"""Fitting a field to photographs: what nerf-pretraining and joint-optimization share of a training step."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int16, Int32
from numpy.typing import NDArray
from torch import Tensor

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.fitting import LossWeights
from inpaint3d.radiance.losses import charbonnier, distortion_loss, interlevel_loss
from inpaint3d.radiance.optim import Adam
from inpaint3d.radiance.rays import CameraStack, Rays
from inpaint3d.radiance.rendering import Rendering
from inpaint3d.scene.cameras import Camera


@dataclass(frozen=True)
class Pixels:
    """Known pixels of the training views, in one row each; `view` indexes `cameras` and the appearance codes.

    20 bytes a pixel: a capture has millions.
    """

    cameras: CameraStack
    view: Int32[Tensor, " p"]
    column_row: Int16[Tensor, "p 2"]
    rgb: Float[Tensor, "p 3"]

    @classmethod
    def of(
        cls,
        cameras: Sequence[Camera],
        images: Sequence[NDArray[np.float32]],
        known: Sequence[NDArray[np.bool_] | None],
        device: torch.device | str = "cpu",
    ) -> "Pixels":
        """All pixels of `images` [h, w, 3] where `known` [h, w] is True (None: everywhere)."""
        kept = [np.ones(image.shape[:2], bool) if k is None else k for image, k in zip(images, known, strict=True)]
        ends = np.cumsum([0, *(int(k.sum()) for k in kept)])
        view = np.empty(ends[-1], np.int32)
        column_row, rgb = np.empty((ends[-1], 2), np.int16), np.empty((ends[-1], 3), np.float32)
        for index, (image, keep) in enumerate(zip(images, kept, strict=True)):
            part = slice(ends[index], ends[index + 1])
            view[part], rgb[part] = index, image[keep]
            column_row[part] = np.argwhere(keep)[:, ::-1]
        tensors = [torch.from_numpy(array).to(device) for array in (view, column_row, rgb)]
        return cls(CameraStack.of(cameras, device), *tensors)

    def __len__(self) -> int:
        return len(self.view)

    def draw(self, count: int, generator: torch.Generator) -> tuple[Rays, Float[Tensor, "{count} 3"]]:
        """Rays and colours of `count` pixels, drawn with replacement."""
        chosen = torch.randint(len(self), (count,), generator=generator, device=generator.device).to(self.view.device)
        centre = self.column_row[chosen].float() + 0.5
        return self.cameras.rays(self.view[chosen].long(), centre), self.rgb[chosen]


def regularisers(rendering: Rendering, weights: LossWeights) -> dict[str, Tensor]:
    """The weighted terms that need no photograph; a term of weight 0 is left out, not computed."""
    terms: dict[str, Tensor] = {}
    if weights.interlevel and rendering.proposals:
        terms["interlevel"] = weights.interlevel * interlevel_loss(rendering)
    if weights.distortion:
        terms["distortion"] = weights.distortion * distortion_loss(rendering)
    return terms


def reconstruction(rgb: Float[Tensor, "*n 3"], target: Float[Tensor, "*n 3"], weight: float = 1.0) -> Float[Tensor, ""]:
    """Charbonnier loss of colours, mean over rays and channels (L1, L8)."""
    return weight * charbonnier(rgb - target).mean()


def descend(
    field: RadianceField, optimizer: Adam, terms: Mapping[str, Tensor], rate: float, non_finite: dict[str, int]
) -> dict[str, float]:
    """One step down the sum of the terms at learning rate `rate`; returns each term's value. A density grid learns.

    Non-finite terms and gradients are counted into `non_finite` by place and raise a NonFiniteError that names them. A
    term that is not finite moves no parameter; a number whose gradient is not is not moved itself.
    """
    step = optimizer.steps
    field.zero_grad()
    values = dict(zip(terms, torch.stack([term.detach() for term in terms.values()]).tolist(), strict=True))
    places = {f"loss.{name}": 1 for name, value in values.items() if not math.isfinite(value)}
    if not places:
        torch.stack(list(terms.values())).sum().backward()
        optimizer.step(rate)
        if field.density_grid is not None:
            field.density_grid.learn(field.backend)
        names = {id(parameter): name for name, parameter in field.named_parameters()}
        places = {f"gradient.{names[id(parameter)]}": count for parameter, count in optimizer.lost.items()}
    if places:
        for place, count in places.items():
            non_finite[place] = non_finite.get(place, 0) + count
        said = ", ".join(f"{place} ({count})" for place, count in sorted(places.items()))
        raise NonFiniteError(f"non-finite values at step {step}: {said}; loss terms were {values}")
    return values


def rays_at(step: int, *, first: int, last: int, ramp: int) -> int:
    """Rays of a step: geometric from first to last over `ramp` steps. Small batches learn faster while all is wrong."""
    share = min(step / ramp, 1.0) if ramp else 1.0
    return round(first * (last / first) ** share)


def proposal_anneal(step: int, steps: int, slope: float = 10.0) -> float:
    """Power on the proposals' weights, 0 to 1 over `steps` (Mip-NeRF 360, arXiv:2111.12077, eq. 18)."""
    share = min(step / max(steps, 1), 1.0)
    return slope * share / ((slope - 1) * share + 1)
