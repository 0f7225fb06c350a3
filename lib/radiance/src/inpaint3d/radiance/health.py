"""Whether a fit is still one of finite numbers: checked before anything is kept, and counted on the way."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.radiance import safe
from inpaint3d.radiance.backends.reference import COLOUR_PADDING
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.optim import Adam
from inpaint3d.radiance.rays import Rays
from inpaint3d.radiance.rendering import render
from inpaint3d.scene import finite
from inpaint3d.scene.finite import NonFinite

NEARLY_CEILING = math.exp(safe.EXP_CEILING) * (1 - 1e-6)


def find_non_finite(tensors: Mapping[str, Tensor]) -> list[NonFinite]:
    """`finite.find_non_finite` of tensors, wherever they lie."""
    return finite.find_non_finite(
        {name: t.detach().float().cpu().numpy() for name, t in tensors.items() if t.is_floating_point()}
    )


def check_finite(field: RadianceField, optimizer: Adam | None = None) -> None:
    """NonFiniteError where a weight, a moment of Adam's or a density of the grid is not finite."""
    tensors: dict[str, Tensor] = dict(field.named_buffers())
    for name, parameter in field.named_parameters():
        tensors[name] = parameter
        if optimizer is not None:
            tensors[f"first moment of {name}"], tensors[f"second moment of {name}"] = optimizer.moments(parameter)
    if found := find_non_finite(tensors):
        step = "" if optimizer is None else f" after step {optimizer.steps}"
        raise NonFiniteError(f"weights that are not finite{step}: {', '.join(map(str, found))}")


COUNTERS = ("gradient_norm_largest", "gradient_norm_last", "density_at_ceiling", "colour_saturated")


class Health:
    """Counters of a fit: what an artifact and the report say of it.

    gradient_norm_largest and _last: over all parameters, where it was looked at. density_at_ceiling, colour_saturated:
    the largest shares of samples of `safe.exp` at its ceiling, and of colours so near black or white that their slope
    is held up (`safe.sigmoid`).
    """

    def __init__(self) -> None:
        self._counters: dict[str, float] = dict.fromkeys(COUNTERS, 0.0)

    @torch.no_grad()
    def look(self, field: RadianceField, rays: Rays) -> None:
        """Take in the gradients as they are, and what the field says along some rays; cheap, but not for every step."""
        norm = math.hypot(*(_measure_length(p.grad) for p in field.parameters() if p.grad is not None))
        self._counters["gradient_norm_last"] = norm
        self._raise("gradient_norm_largest", norm)
        tdist = render(field, rays).tdist
        middle = (tdist[:, 1:] + tdist[:, :-1]) / 2
        points = rays.origins[:, None] + rays.directions[:, None] * middle[..., None]
        samples = field.query(points.reshape(-1, 3), rays.directions, field.appearance(None, "mean"))
        share = (samples.rgb + COLOUR_PADDING) / (1 + 2 * COLOUR_PADDING)
        self._raise("density_at_ceiling", float((samples.density >= NEARLY_CEILING).float().mean()))
        self._raise("colour_saturated", float((share * (1 - share) < safe.LEAST_SLOPE).float().mean()))

    def counters(self, optimizer: Adam) -> dict[str, float]:
        """By name, with how often the fit went back; six significant digits."""
        return {n: float(f"{v:.6g}") for n, v in self._counters.items()} | {"rollbacks": float(optimizer.halvings)}

    def tensors(self) -> dict[str, Tensor]:
        """For a checkpoint."""
        return {"health": torch.tensor([self._counters[name] for name in COUNTERS], dtype=torch.float64)}

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """From a checkpoint."""
        self._counters = dict(zip(COUNTERS, tensors["health"].tolist(), strict=True))

    def _raise(self, name: str, value: float) -> None:
        self._counters[name] = max(value, self._counters[name])


def _measure_length(gradient: Tensor) -> float:
    """Euclidean length; in float64 where squares overflow, which costs a copy."""
    length = float(torch.linalg.vector_norm(gradient))
    return length if math.isfinite(length) else float(torch.linalg.vector_norm(gradient, dtype=torch.float64))
