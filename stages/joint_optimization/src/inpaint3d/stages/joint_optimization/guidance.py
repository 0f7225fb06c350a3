"""What fills the hole: for a rendered patch, one constant gradient (rows S2 to S5, L8).

One interface, `Guide`; who it is, `run.load_guide` decides by the parameter `estimator`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.diffusion.distillation import (
    PriorQuery,
    dataset_gradient,
    denoised_target,
    denoised_target_gradient,
    ism_gradient,
    nfsd_gradient,
    sdi_gradient,
    sds_gradient,
    vsd_gradient,
)
from inpaint3d.diffusion.low_rank import LowRankCopy
from inpaint3d.stages.joint_optimization.patches import Window

Patch = Float[Tensor, "h w 3"]
Hole = Bool[Tensor, "h w"]
Windows = Sequence[Window | None]
PriorEstimator = Literal["sds", "nfsd", "sdi", "ism", "vsd", "denoised-target"]


class Guide(Protocol):
    """Turns a rendered patch into the gradient that its hole descends."""

    @property
    def size(self) -> int:
        """Side of the patches that it looks at."""
        ...

    @property
    def windows(self) -> Windows | None:
        """Each view's window, where the guide keeps a picture of every view; None: windows are drawn."""
        ...

    @property
    def span(self) -> float | None:
        """Side of the windows that are drawn, share of the picture's short side; None: as scheduled (S1)."""
        ...

    def gradient(
        self, patch: Patch, hole: Hole, window: Window, timesteps: tuple[float, float], generator: torch.Generator
    ) -> tuple[Patch, float]:
        """d(loss)/d(patch) for a patch rendered in [0, 1], and the diffusion time t that was drawn (NaN: none).

        Outside the hole the gradient is 0. All that is random comes from `generator`.
        """
        ...

    def state(self) -> dict[str, Tensor]:
        """What it has learnt on the way, for a checkpoint."""
        ...

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """From a checkpoint."""
        ...


class Asked(NamedTuple):
    """A patch as a prior is asked about it: x in [-1, 1], batch of one; t, noise and fill are fresh (S3).

    eps is of the shape of the patch's code, which for a prior over pixels is the patch's.
    """

    x: Float[Tensor, "1 3 h w"]
    mask: Float[Tensor, "1 1 h w"]
    t: Float[Tensor, "1"]
    eps: Float[Tensor, "1 c y x"]
    noise_fill: Float[Tensor, "1 3 h w"]

    @classmethod
    def about(
        cls,
        patch: Patch,
        hole: Hole,
        timesteps: tuple[float, float],
        generator: torch.Generator,
        latent_shape: tuple[int, int, int],
    ) -> "Asked":
        low, high = timesteps
        t = low + (high - low) * torch.rand((), generator=generator)
        x = (2.0 * patch.detach() - 1.0).permute(2, 0, 1)[None]
        eps, noise_fill = (torch.randn(1, *shape, generator=generator).to(x) for shape in (latent_shape, x.shape[1:]))
        return cls(x, hole[None, None].to(x), t.reshape(1).to(x), eps, noise_fill)

    def answered(self, gradient: Float[Tensor, "1 3 h w"]) -> tuple[Patch, float]:
        """As that of a mean over the patch's pixels, of a picture in [-1, 1]: a factor 2 and a division (L8)."""
        return gradient[0].permute(1, 2, 0) * (2.0 / self.mask.numel()), float(self.t)


class Stateless:
    """What a guide that learns nothing brings to a checkpoint: nothing."""

    def state(self) -> dict[str, Tensor]:
        return {}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        pass


@dataclass
class PriorGuide:
    """A prior with the estimator that turns its opinion into a gradient. copy: vsd's, which learns the renders."""

    prior: Denoiser
    estimator: PriorEstimator
    guidance: float
    steps: int
    copy: LowRankCopy | None = None
    windows: None = None
    span: None = None

    @property
    def size(self) -> int:
        return self.prior.size

    def gradient(
        self,
        patch: Patch,
        hole: Hole,
        window: Window,  # noqa: ARG002 - a prior needs not know where it looks
        timesteps: tuple[float, float],
        generator: torch.Generator,
    ) -> tuple[Patch, float]:
        asked = Asked.about(patch, hole, timesteps, generator, self.prior.latent_shape)
        return asked.answered(self._estimate(asked, timesteps, generator))

    def _estimate(self, asked: Asked, timesteps: tuple[float, float], generator: torch.Generator) -> Tensor:
        x, mask, *_ = asked
        prior, g, steps = self.prior, self.guidance, self.steps
        match self.estimator:
            case "sds":
                return sds_gradient(prior, PriorQuery(*asked), guidance=g)
            case "nfsd":
                return nfsd_gradient(prior, PriorQuery(*asked), guidance=g)
            case "sdi":
                return sdi_gradient(prior, PriorQuery(*asked), guidance=g, steps=steps)
            case "ism":
                return ism_gradient(prior, PriorQuery(*asked), guidance=g, steps=steps)
            case "denoised-target":
                return denoised_target_gradient(prior, PriorQuery(*asked), guidance=g, steps=steps)
            case "vsd":
                if self.copy is None:
                    raise ValueError("vsd needs a copy of the prior to learn the renders")
                gradient = vsd_gradient(prior, self.copy.network, PriorQuery(*asked), guidance=g)
                self.copy.learn(x, mask, generator, timesteps)
                return gradient

    def state(self) -> dict[str, Tensor]:
        return {} if self.copy is None else self.copy.state()

    def restore(self, tensors: dict[str, Tensor]) -> None:
        if self.copy is not None:
            self.copy.restore(tensors)


class DatasetGuide:
    """Iterative dataset update (arXiv:2303.12789): a picture of every view, made again from its render now and then.

    update_every: patches of a view from one update to the next; the first makes it.
    """

    span = None

    def __init__(self, prior: Denoiser, windows: Windows, *, guidance: float, steps: int, update_every: int) -> None:
        self.prior, self.windows, self.size = prior, windows, prior.size
        self._guidance, self._steps, self._every = guidance, steps, update_every
        self._targets = torch.zeros(len(windows), 3, self.size, self.size)
        self._seen = torch.zeros(len(windows), dtype=torch.int64)

    def gradient(
        self, patch: Patch, hole: Hole, window: Window, timesteps: tuple[float, float], generator: torch.Generator
    ) -> tuple[Patch, float]:
        asked = Asked.about(patch, hole, timesteps, generator, self.prior.latent_shape)
        x, mask, *_ = asked
        if self._seen[window.view] % self._every == 0:
            made = denoised_target(self.prior, PriorQuery(*asked), guidance=self._guidance, steps=self._steps)
            self._targets[window.view] = made[0].cpu()
        self._seen[window.view] += 1
        return asked.answered(dataset_gradient(x, mask, self._targets[window.view][None].to(x)))

    def state(self) -> dict[str, Tensor]:
        return {"targets": self._targets, "seen": self._seen}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        self._targets, self._seen = tensors["targets"], tensors["seen"]


def evaluations(estimator: str, *, guidance: float, steps: int) -> int:
    """UNet evaluations of a distilled step without learning; a backward pass, where there is one, counts as two.

    steps: DDIM or inversion steps. An update of dataset-update costs what a denoised target does.
    """
    asked = 1 if guidance in (0.0, 1.0) else 2
    return {
        "sds": asked,
        "nfsd": asked + 1,
        "sdi": steps + asked,
        "ism": steps + 1 + asked,
        "vsd": asked + 1 + 3,
        "denoised-target": steps * asked,
        "dataset-update": steps * asked,
    }.get(estimator, 0)
