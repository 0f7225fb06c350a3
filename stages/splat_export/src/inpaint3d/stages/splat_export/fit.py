"""Move splats until their pictures are the targets (3D Gaussian Splatting, arXiv:2308.04079, section 5), without
densification: the field has already told where surfaces are.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.radiance.backends import AdamStep, Backend, select
from inpaint3d.radiance.splats import Splats, View, render_splats
from inpaint3d.scene.finite import find_non_finite
from inpaint3d.stages.splat_export.cloud import SplatCloud
from inpaint3d.stages.splat_export.targets import Target

RATES = {"log_scale": 0.04, "rotation": 0.03, "opacity": 0.05, "rgb": 0.02}
SLOWEST = 0.1  # of the learning rates, at the last step
BETAS, EPS = (0.9, 0.99), 1e-15
FAINTEST = -5.3  # logit: an opacity under 1/200 is hardly ever seen
WINDOW, STRIDE = 7, 3  # pixels: sides of SSIM's windows, and how far apart they lie
C1, C2 = 0.01**2, 0.03**2


@dataclass(frozen=True)
class Schedule:
    """steps: pictures that are looked at. position_rate: scene units a step, at first. similarity: weight of 1 - SSIM,
    the L1 difference has the rest (eq. 7).
    """

    steps: int
    position_rate: float
    similarity: float
    seed: int


def fit(
    start: SplatCloud, targets: Sequence[Target], how: Schedule, on_step: Callable[[int, float], None]
) -> SplatCloud:
    """The splats after `how.steps` steps of Adam, those that have become too faint to be seen left out.

    on_step is told the step, from 1, and its loss. NonFiniteError where numbers are not finite.
    """
    splats = Splats(**{name: torch.from_numpy(array.copy()).requires_grad_() for name, array in start.arrays.items()})
    adam = _Adam(splats, RATES | {"mean": how.position_rate})
    order = _draw_order(len(targets), np.random.default_rng(how.seed))
    for step in range(1, how.steps + 1):
        target = targets[next(order)]
        loss = measure_loss(
            render_splats(splats, View.of(target.camera)),
            torch.from_numpy(target.picture),
            torch.from_numpy(target.counts),
            how.similarity,
        )
        loss.backward()
        adam.step(step, SLOWEST ** (step / how.steps))
        on_step(step, loss.item())
    fitted = SplatCloud(**{name: getattr(splats, name).detach().numpy() for name in start.arrays})
    if strange := find_non_finite(fitted.arrays):
        raise NonFiniteError(f"the fit came to splats that are not finite: {', '.join(map(str, strange))}")
    return fitted.map(lambda array: array[fitted.opacity > FAINTEST])


def _draw_order(count: int, rng: np.random.Generator) -> Iterator[int]:
    """Every number below `count` once, in an order by chance; and again."""
    while True:
        yield from rng.permutation(count).tolist()


class _Adam:
    """Adam with a rate for each array; splats that a view does not show rest."""

    def __init__(self, splats: Splats, rates: dict[str, float]) -> None:
        self._splats, self._rates = splats, rates
        self._moments = {name: (torch.zeros_like(t), torch.zeros_like(t)) for name, t in splats.named().items()}
        self._backend: Backend = select("cpu")

    @torch.no_grad()
    def step(self, number: int, share: float) -> None:
        for name, tensor in self._splats.named().items():
            if (grad := tensor.grad) is None:
                continue
            how = AdamStep(number, self._rates[name] * share, *BETAS, EPS, 0.0, True)
            self._backend.adam_step(tensor, grad, *self._moments[name], how)
            tensor.grad = None
        # Every format keeps colours of a picture alone.
        self._splats.rgb.clamp_(0, 1)


def measure_loss(
    rgb: Float[Tensor, "h w 3"], truth: Float[Tensor, "h w 3"], counts: Bool[Tensor, "h w"], similarity: float
) -> Float[Tensor, ""]:
    """Mean absolute difference of the pixels that count, and 1 - SSIM, whose windows see the others as equal."""
    rgb = torch.where(counts[..., None], rgb, truth)
    difference = (rgb - truth).abs().mean()
    if similarity == 0:
        return difference
    return (1 - similarity) * difference + similarity * (1 - mean_ssim(rgb, truth))


def mean_ssim(image: Float[Tensor, "h w 3"], truth: Float[Tensor, "h w 3"]) -> Float[Tensor, ""]:
    """SSIM (Wang et al. 2004) of windows of WINDOW px, every STRIDE px, that weigh their pixels alike: a tenth of the
    cost of round windows at every pixel. Pictures smaller than a window are one window.
    """
    x, y = image.permute(2, 0, 1)[None], truth.permute(2, 0, 1)[None]
    size = (min(WINDOW, image.shape[0]), min(WINDOW, image.shape[1]))
    means = F.avg_pool2d(torch.cat([x, y, x * x, y * y, x * y]), size, STRIDE)
    mean_x, mean_y, mean_xx, mean_yy, mean_xy = means.split(1)
    spread = mean_xx - mean_x**2 + mean_yy - mean_y**2
    together = mean_xy - mean_x * mean_y
    similar = (2 * mean_x * mean_y + C1) * (2 * together + C2) / ((mean_x**2 + mean_y**2 + C1) * (spread + C2))
    return similar.mean()
