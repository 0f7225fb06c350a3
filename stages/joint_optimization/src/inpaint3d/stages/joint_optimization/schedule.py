"""When each term acts and how strongly: pure functions of the step (Inpaint3D, sec. 3.3 and appendix; rows S6 to S10).

`step` counts from the start of the optimisation, `since` from the start of score distillation (negative before it).
"""

import math
from typing import NamedTuple


class TimestepRange(NamedTuple):
    """t ~ U(low, high); `floored` says that the floor moved `low`."""

    low: float
    high: float
    floored: bool


def distillation_weight(since: int, total: int, *, peak: float, warmup: int = 100, decay_to: float = 1.0) -> float:
    """Weight of score distillation (S6, S13): linear from 0 to `peak` over `warmup` steps, then fixed.

    `decay_to` < 1 lets it fall along a half cosine from `peak` to `decay_to * peak` at `total` steps of distillation
    (the paper's SPIn-NeRF settings: 1/4).
    """
    if since < 0:
        return 0.0
    rise = min(1.0, since / warmup) if warmup else 1.0
    along = min(1.0, max(0, since - warmup) / max(1, total - warmup))
    fall = decay_to + (1.0 - decay_to) * 0.5 * (1.0 + math.cos(math.pi * along))
    return peak * rise * fall


def timestep_range(
    step: int, total: int, *, t_min: float = 0.2, t_max: float = 0.95, width: float = 0.2, floor: float = 0.02
) -> TimestepRange:
    """Where the diffusion time is drawn from at a global step (S9, the paper's eq. of p(t)).

    eta = max(t_min, t_max (1 - s / S)), t ~ U(eta - width, eta). With the paper's t_min = width the lower end reaches
    0, where alpha / sigma has no bound: it stops at `floor`.
    """
    eta = max(t_min, t_max * (1.0 - step / total))
    low = eta - width
    return TimestepRange(max(low, floor), max(eta, floor), low < floor)


def specular_scale(step: int, total: int) -> float:
    """Share of the view-dependent colour in what the prior sees (S10): 0 at the start, 1 from half of `total` on."""
    return min(1.0, step / (0.5 * total))


def centre_views_only(since: int, steps: int = 50) -> bool:
    """Whether distillation keeps to the centre views (S8), counted from its start: before it, this has no effect."""
    return 0 <= since < steps


def window_span(since: int, total: int, *, first: float, last: float) -> float:
    """Side of the distilled window as a share of the picture's short side (S1): geometric from `first` to `last`."""
    along = min(1.0, max(0.0, since / max(1, total - 1)))
    return first * (last / first) ** along


def terms_due(step: int, since: int, every: int, distill_every: int) -> bool:
    """Whether the gradients of the terms are measured (L8): every `every` steps, or at the next one that distils.

    `since` is negative throughout where no prior is used. A plain multiple would miss every distilled step where
    `every` and `distill_every` have a factor in common.
    """
    done = step + 1
    if since < 0:
        return done % every == 0
    return since % distill_every == 0 and done >= every and done % every < distill_every
