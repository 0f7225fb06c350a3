"""What pulls the hole: for a rendered patch, one constant gradient (rows S2 to S5, L8).

One interface, `Guide`; which one, and with what parameters, is the estimator's to say (`estimators`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor

from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.diffusion.distillation import PriorQuery, dataset_gradient, denoised_target
from inpaint3d.diffusion.low_rank import LowRankCopy
from inpaint3d.perception.lpips import enlarge, load
from inpaint3d.scene.windows import Window
from inpaint3d.stages.joint_optimization.schedule import TimestepRange

Patch = Float[Tensor, "h w 3"]
Hole = Bool[Tensor, "h w"]
Windows = Sequence[Window | None]
Timesteps = TimestepRange | None


class Guide(Protocol):
    """Turns a rendered patch into the gradient that its hole descends."""

    @property
    def size(self) -> int:
        """Side of the patches that it looks at."""
        ...

    @property
    def windows(self) -> Windows | None:
        """Each view's window, where the guide keeps to one; None: windows are drawn."""
        ...

    @property
    def needs_surround(self) -> bool:
        """Whether it looks at what the field shows around the hole; where not, only the hole is rendered for it."""
        ...

    def gradient(
        self, patch: Patch, hole: Hole, window: Window, timesteps: Timesteps, generator: torch.Generator
    ) -> tuple[Patch, float]:
        """d(loss)/d(patch) for a patch rendered in [0, 1], and the diffusion time t that was drawn (NaN: none).

        Outside the hole the gradient is 0, and so is the patch for a guide that needs no surround. All that is random
        comes from `generator`.
        """
        ...

    def state(self) -> dict[str, Tensor]:
        """What it has learnt on the way, for a checkpoint."""
        ...

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """From a checkpoint."""
        ...


def draw_query(
    patch: Patch, hole: Hole, timesteps: Timesteps, generator: torch.Generator, latent_shape: tuple[int, int, int]
) -> PriorQuery:
    """A query about a patch, as a batch of one, at a time within `timesteps`; time, noise and fill are fresh (S3).

    latent_shape: of the patch's code, which for a prior over pixels is the patch's. ValueError without times.
    """
    if timesteps is None:
        raise ValueError("a prior is asked at a diffusion time, and the estimator has none")
    drawn_on = generator.device
    t = timesteps.low + (timesteps.high - timesteps.low) * torch.rand((), generator=generator, device=drawn_on)
    x = (2.0 * patch.detach() - 1.0).permute(2, 0, 1)[None]
    eps, noise_fill = (
        torch.randn(1, *shape, generator=generator, device=drawn_on).to(x) for shape in (latent_shape, x.shape[1:])
    )
    return PriorQuery(x, hole[None, None].to(x), t.reshape(1).to(x), eps, noise_fill)


def scale_answer(gradient: Float[Tensor, "1 3 h w"]) -> Patch:
    """As that of a mean over the patch's pixels, of a picture in [-1, 1]: a factor 2 and a division (L8)."""
    _, _, height, width = gradient.shape
    return gradient[0].permute(1, 2, 0) * (2.0 / (height * width))


class Stateless:
    """What a guide that learns nothing brings to a checkpoint: nothing."""

    def state(self) -> dict[str, Tensor]:
        return {}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        pass


@dataclass
class PriorGuide:
    """A prior with the estimate that turns its opinion into a gradient. copy: vsd's, which learns the renders."""

    prior: Denoiser
    estimate: Callable[[PriorQuery], Float[Tensor, "1 3 h w"]]
    copy: LowRankCopy | None = None
    windows: None = None
    needs_surround: bool = True

    @property
    def size(self) -> int:
        return self.prior.size

    def gradient(
        self,
        patch: Patch,
        hole: Hole,
        window: Window,  # noqa: ARG002 - a prior needs not know where it looks
        timesteps: Timesteps,
        generator: torch.Generator,
    ) -> tuple[Patch, float]:
        query = draw_query(patch, hole, timesteps, generator, self.prior.latent_shape)
        answer = scale_answer(self.estimate(query)), float(query.t)
        if self.copy is not None and timesteps is not None:
            self.copy.learn(query.x, query.mask, generator, (timesteps.low, timesteps.high))
        return answer

    def state(self) -> dict[str, Tensor]:
        return {} if self.copy is None else self.copy.state()

    def restore(self, tensors: dict[str, Tensor]) -> None:
        if self.copy is not None:
            self.copy.restore(tensors)


class DatasetGuide:
    """A picture of every view, made again from its render now and then.

    update_every: patches of a view from one update to the next; the first makes it.
    """

    needs_surround = True

    def __init__(self, prior: Denoiser, windows: Windows, *, guidance: float, steps: int, update_every: int) -> None:
        self.prior, self.windows, self.size = prior, windows, prior.size
        self._guidance, self._steps, self._every = guidance, steps, update_every
        self._targets = torch.zeros(len(windows), 3, self.size, self.size)
        self._seen = torch.zeros(len(windows), dtype=torch.int64)

    def gradient(
        self, patch: Patch, hole: Hole, window: Window, timesteps: Timesteps, generator: torch.Generator
    ) -> tuple[Patch, float]:
        query = draw_query(patch, hole, timesteps, generator, self.prior.latent_shape)
        if self._seen[window.view] % self._every == 0:
            made = denoised_target(self.prior, query, guidance=self._guidance, steps=self._steps)
            self._targets[window.view] = made[0].cpu()
        self._seen[window.view] += 1
        target = self._targets[window.view][None].to(query.x)
        return scale_answer(dataset_gradient(query.x, query.mask, target)), float(query.t)

    def state(self) -> dict[str, Tensor]:
        return {"targets": self._targets, "seen": self._seen}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        self._targets, self._seen = tensors["targets"], tensors["seen"]


class PictureGuide(Stateless):
    """Whole pictures [h, w, 3] of every view: LPIPS of the hole in windows of them, the rest being the picture's own.

    It sharpens what rays are fitted to pixel by pixel. windows: each view's only one; None: any.
    """

    needs_surround = False

    def __init__(self, pictures: Sequence[NDArray[np.float32]], size: int, windows: Windows | None = None) -> None:
        self.size, self.windows, self._pictures = size, windows, pictures

    def gradient(
        self,
        patch: Patch,
        hole: Hole,
        window: Window,
        timesteps: Timesteps,  # noqa: ARG002 - nothing is noised here
        generator: torch.Generator,  # noqa: ARG002 - nor drawn
    ) -> tuple[Patch, float]:
        picture = torch.from_numpy(np.ascontiguousarray(window.sample(self._pictures[window.view]))).to(patch)
        rendered = patch.detach().requires_grad_()
        # Apart: what is wanted needs no graph, which would cost as much backwards again.
        made = _to_batch(torch.where(hole[..., None], rendered, picture))
        (gradient,) = torch.autograd.grad(load("vgg", made.device).difference(made, _to_batch(picture)).sum(), rendered)
        return gradient, float("nan")


def _to_batch(picture: Patch) -> Float[Tensor, "1 3 h w"]:
    """A picture in [0, 1] as LPIPS takes it."""
    return enlarge(picture.permute(2, 0, 1)[None] * 2 - 1)
