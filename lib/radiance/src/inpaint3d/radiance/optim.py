"""Adam over a field's tables and networks, and the paper's schedule of its rate (conformance N7)."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.memory import roomy

BETAS = (0.9, 0.99)
EPS = 1e-15


def learning_rate(
    step: int, *, initial: float = 1e-2, final: float = 1e-3, steps: int = 2200, warmup: int = 100
) -> float:
    """Exponential from initial to final over `steps`, then constant; times a linear warm-up. Steps count from 0."""
    share = min(step / max(steps, 1), 1.0)
    return initial * (final / initial) ** share * min((step + 1) / max(warmup, 1), 1.0)


class Adam(torch.optim.Optimizer):
    """Adam with the field's backend. Each group has `lr` and its `lr_scale`; the state is m, v, and one step count.

    What it descends is the loss whose gradient it finds, and `hash_decay` times `losses.hash_decay` (N9). sparse: the
    tables' numbers without a gradient rest, moments and decay too. Numbers whose gradient is not finite are not moved:
    `lost` counts those of the last step.
    """

    def __init__(
        self,
        field: RadianceField,
        groups: list[dict[str, Any]],
        betas: tuple[float, float],
        eps: float,
        hash_decay: float,
        sparse: bool,
    ) -> None:
        self._field, self._sparse = field, sparse
        self._levels = {
            id(grid.table): [
                (slice(level.offset, level.offset + level.size), 2 * hash_decay / (level.size * grid.table.shape[1]))
                for level in grid.levels
            ]
            for grid in field.hash_networks
        }
        self.steps = 0
        self.lost: dict[Tensor, int] = {}
        super().__init__(groups, {"lr": 1e-2, "lr_scale": 1.0, "betas": betas, "eps": eps})

    def set_rate(self, rate: float) -> None:
        """Use `rate` from the next step on, times each group's scale."""
        for group in self.param_groups:
            group["lr"] = rate * group["lr_scale"]

    def moments(self, param: Tensor) -> tuple[Tensor, Tensor]:
        """Adam's m and v of a parameter; zeros before its first step."""
        state = self.state[param]
        if not state:
            state["m"], state["v"] = roomy(param).zero_(), roomy(param).zero_()
        return state["m"], state["v"]

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Move all parameters that have a gradient."""
        if closure is not None:
            raise ValueError("this Adam takes no closure; compute the loss before the step")
        self.steps += 1
        self.lost.clear()
        for group in self.param_groups:
            for param in group["params"]:
                if param.grad is not None:
                    self._move(param, param.grad, group)

    def _move(self, param: Tensor, grad: Tensor, group: dict[str, Any]) -> None:
        m, v = self.moments(param)
        beta1, beta2 = group["betas"]
        levels = self._levels.get(id(param))
        sparse = self._sparse and levels is not None
        lost = 0
        # A level's mean square weighs each of its entries by one over their number: the levels decay apart.
        for part, decay in levels or [(slice(None), 0.0)]:
            of = (param[part], grad[part], m[part], v[part])
            lost += self._field.backend.adam_step(
                *of, self.steps, group["lr"], beta1, beta2, group["eps"], decay, sparse
            )
        if lost:
            self.lost[param] = lost


def make_optimizer(
    field: RadianceField,
    *,
    network_scale: float = 1.0,
    hash_decay: float = 0.0,
    sparse: bool = False,
    betas: tuple[float, float] = BETAS,
    eps: float = EPS,
) -> Adam:
    """Adam whose networks (all but the tables) learn at `network_scale` of the rate; `set_rate` before each step.

    hash_decay: weight of the tables' decay (N9). sparse: see `Adam`.
    """
    tables = [network.table for network in field.hash_networks]
    chosen = {id(t) for t in tables}
    networks = [p for p in field.parameters() if id(p) not in chosen]
    return Adam(
        field, [{"params": tables}, {"params": networks, "lr_scale": network_scale}], betas, eps, hash_decay, sparse
    )
