"""What distillation and the samplers ask of an inpainting prior, whoever trained it and whatever runs it."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d.contracts.errors import BadInputError

Image = Float[Tensor, "b 3 h w"]
Mask = Float[Tensor, "b 1 h w"]
Times = Float[Tensor, "b"]
Latent = Float[Tensor, "b c y x"]
"""Pictures as the prior denoises them: the pixels themselves, or the codes of an autoencoder."""


@runtime_checkable
class Denoiser(Protocol):
    """An inpainting prior. Images are in [-1, 1], masks 1 inside the hole; z_t = alpha(t) encode(x) + sigma(t) eps.

    t is the cosine schedule's: whatever schedule a prior was trained on, it is asked at the same log SNR.
    """

    @property
    def size(self) -> int:
        """Side of the square pictures that it was trained on, pixels."""
        ...

    @property
    def latent_shape(self) -> tuple[int, int, int]:
        """Channels, height and width of such a picture in the space that z_t lives in."""
        ...

    @property
    def bound(self) -> float | None:
        """Clean latents lie within +-bound; None where they have no bound."""
        ...

    def encode(self, image: Image) -> Latent:
        """A picture in the space that z_t lives in; differentiable."""
        ...

    def decode(self, latent: Latent) -> Image:
        """The picture of a clean latent."""
        ...

    def predict_noise(
        self, z: Latent, t: Times, image: Image, mask: Mask, *, guidance: float = 1.0, noise_fill: Image | None = None
    ) -> Latent:
        """eps_hat(z_t; t, y), with z noised everywhere. What `image` holds under the mask is never looked at.

        guidance g: eps_null + g (eps_cond - eps_null), where the null condition shows a hole over everything.
        noise_fill: N(0, 1), for priors that are shown the hole as noise (conformance D5).
        """
        ...


def check_answer(answer: Tensor, t: Tensor) -> Tensor:
    """The answer, as it is. BadInputError where it is not finite: bounds that are put on it later would hide that."""
    strange = int((~torch.isfinite(answer)).sum())
    if strange:
        times = ", ".join(f"{time:.3f}" for time in t.detach().reshape(-1)[:3].tolist())
        raise BadInputError(
            f"the prior answered {strange} of {answer.numel()} numbers that are not finite at diffusion time {times}; "
            "take another prior, or one whose weights and activations fit its number format"
        )
    return answer


def guide_noise(conditional: Callable[[], Latent], null: Callable[[], Latent], guidance: float) -> Latent:
    """Classifier-free guidance, eps_null + guidance * (eps_cond - eps_null) (arXiv:2207.12598; S5).

    guidance 1 is the conditional estimate and 0 the unconditional one; each costs one network call, other values two.
    """
    if guidance == 1:
        return conditional()
    eps_null = null()
    if guidance == 0:
        return eps_null
    return eps_null + guidance * (conditional() - eps_null)
