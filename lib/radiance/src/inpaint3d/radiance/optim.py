"""Adam over a field's tables and networks, and the paper's schedule of its rate (conformance N7)."""

from collections.abc import Callable

import torch
from torch import Tensor

from inpaint3d.radiance.backends.reference import AdamStep
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.fitting import LossWeights, Optimizer
from inpaint3d.radiance.memory import allocate_like

BETAS = (0.9, 0.99)
EPS = 1e-15


def learning_rate(
    step: int, *, initial: float = 1e-2, final: float = 1e-3, steps: int = 2200, warmup: int = 100
) -> float:
    """Exponential from initial to final over `steps`; times a linear warm-up. Steps count from 0.

    Beyond `steps`, where the paper says nothing, it falls as 1 / step: at a constant one a field wanders for good.
    """
    steps = max(steps, 1)
    beyond = max(step / steps, 1.0)
    return initial * (final / initial) ** min(step / steps, 1.0) / beyond * min((step + 1) / max(warmup, 1), 1.0)


def scheduled_rate(step: int, optimizer: Optimizer, steps: int) -> float:
    """The learning rate at a step of a fit of `steps` steps."""
    return learning_rate(
        step,
        initial=optimizer.learning_rate,
        final=optimizer.final_learning_rate,
        steps=optimizer.learning_rate_steps or steps,
        warmup=optimizer.learning_rate_warmup,
    )


class Adam:
    """Adam with the field's backend; its state is m, v of each parameter, and one step count.

    What it descends is the loss whose gradient it finds, and `hash_decay` times `losses.hash_decay` (N9). Networks (all
    but the tables) learn at `network_scale` of the rate. sparse: the tables' numbers without a gradient rest, moments
    and decay too. before_step: called at the start of each step; ranks average their gradients there. Numbers that a
    step would not leave finite are not moved: `lost` counts those of the last step. halvings: how often the rate was
    halved, since a fit went back to its last checkpoint.

    Not a torch.optim.Optimizer: the first of those in a process imports torch's compiler, which takes seconds.
    """

    def __init__(
        self,
        field: RadianceField,
        *,
        network_scale: float = 1.0,
        hash_decay: float = 0.0,
        sparse: bool = False,
        betas: tuple[float, float] = BETAS,
        eps: float = EPS,
        before_step: Callable[[], None] | None = None,
    ) -> None:
        self._field, self._sparse, self._network_scale = field, sparse, network_scale
        self._betas, self._eps, self._before_step = betas, eps, before_step
        # The term is a mean over each level's entries: how fast an entry decays depends on how many its level has.
        self._levels = {
            id(grid.table): [
                (slice(level.offset, level.offset + level.size), 2 * hash_decay / (level.size * grid.table.shape[1]))
                for level in grid.levels
            ]
            for grid in field.hash_networks
        }
        self._moments: dict[Tensor, tuple[Tensor, Tensor]] = {}
        self.steps = self.halvings = 0
        self.lost: dict[Tensor, int] = {}

    @classmethod
    def of(
        cls,
        field: RadianceField,
        optimizer: Optimizer,
        weights: LossWeights,
        before_step: Callable[[], None] | None = None,
    ) -> "Adam":
        """As the parameters of a stage ask for."""
        return cls(
            field,
            network_scale=optimizer.network_rate_share,
            hash_decay=weights.hash_decay,
            sparse=optimizer.sparse_adam,
            before_step=before_step,
        )

    def moments(self, param: Tensor) -> tuple[Tensor, Tensor]:
        """Adam's m and v of a parameter; zeros before its first step."""
        if param not in self._moments:
            self._moments[param] = (allocate_like(param).zero_(), allocate_like(param).zero_())
        return self._moments[param]

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """Move all parameters that have a gradient, at a learning rate."""
        if self._before_step is not None:
            self._before_step()
        self.steps += 1
        moved = [param for param in self._field.parameters() if param.grad is not None]
        rate = rate * 0.5**self.halvings
        lost = [self._move(param, param.grad, rate) for param in moved if param.grad is not None]
        # Read in one go: each number that is read from a GPU waits for all that it has been told to do.
        counts = [torch.as_tensor(n, device=p.device) for n, p in zip(lost, moved, strict=True)]
        read = torch.stack(counts).tolist() if counts else []
        self.lost = {param: count for param, count in zip(moved, read, strict=True) if count}

    def _move(self, param: Tensor, grad: Tensor, rate: float) -> int | Tensor:
        m, v = self.moments(param)
        levels = self._levels.get(id(param))
        sparse = self._sparse and levels is not None
        if levels is None:
            rate, levels = rate * self._network_scale, [(slice(None), 0.0)]
        lost = 0
        for part, decay in levels:
            of = (param[part], grad[part], m[part], v[part])
            how = AdamStep(self.steps, rate, *self._betas, self._eps, decay, sparse)
            lost += self._field.backend.adam_step(*of, how)
        return lost
