"""Other people's inpainting models: the parts of a diffusers pipeline as a `Denoiser`.

Taken are pipelines of a UNet and a scheduler with DDPM's noise (a table of alphas_cumprod): over the codes of an
autoencoder (Stable Diffusion 1 and 2 and what is built like it) or over pixels; made for inpainting (the UNet is shown
mask and masked picture too) or not (known codes then keep the noise that they must hold, as in RePaint,
arXiv:2201.09865).
"""

import warnings
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from inpaint3d.diffusion.denoiser import Image, Latent, Mask, Times, guide_noise
from inpaint3d.diffusion.parameterisation import Kind, Parameterisation
from inpaint3d.diffusion.schedules import alpha, cosine_log_snr, per_image, sigma

_PREDICTIONS: dict[str, Kind] = {"epsilon": "eps", "v_prediction": "v", "sample": "x0"}


class PipelinePrior:
    """A `Denoiser` out of a diffusers pipeline. Nothing of it is trained.

    prompt: what a text-conditioned pipeline is told of the picture; the null condition is told nothing, and shown a
    hole over everything. Raises ValueError for a pipeline that is not built like this (see the module).
    """

    def __init__(self, pipeline: Any, prompt: str = "") -> None:
        name = type(pipeline).__name__
        parts = pipeline.components
        self.vae, self.unet = parts.get("vae") or parts.get("vqvae"), parts.get("unet")
        noise = getattr(parts.get("scheduler"), "alphas_cumprod", None)
        if self.unet is None or noise is None:
            raise ValueError(
                f"{name} has no UNet with DDPM's noise, but {', '.join(sorted(parts))}; "
                "give a pipeline like Stable Diffusion's inpainting one"
            )
        kind = pipeline.scheduler.config.get("prediction_type", "epsilon")
        if kind not in _PREDICTIONS:
            raise ValueError(f"the scheduler of {name} predicts {kind!r}; taken are {', '.join(_PREDICTIONS)}")
        self.kind: Kind = _PREDICTIONS[kind]
        self.log_snr = torch.log(noise / (1 - noise))
        self.channels = int(self.unet.config["out_channels"])
        inputs = int(self.unet.config["in_channels"])
        if inputs not in (self.channels, 2 * self.channels + 1):
            raise ValueError(
                f"the UNet of {name} takes {inputs} channels and gives {self.channels}; an inpainting one takes "
                f"{2 * self.channels + 1}, any other {self.channels}"
            )
        self.sees_mask = inputs > self.channels
        self.texts = _encode_texts(pipeline, prompt)
        self.stride = 1 if self.vae is None else 2 ** (len(self.vae.config["block_out_channels"]) - 1)
        self._shown: dict[int, tuple[Image, Latent]] = {}
        for part in (self.unet, self.vae):
            if part is not None:
                part.eval().requires_grad_(False)

    @property
    def size(self) -> int:
        return int(self.unet.config["sample_size"]) * self.stride

    @property
    def latent_shape(self) -> tuple[int, int, int]:
        side = self.size // self.stride
        return (self.channels, side, side)

    @property
    def bound(self) -> float | None:
        return 1.0 if self.vae is None else None

    def to(self, device: str) -> "PipelinePrior":
        """Move it to a device, in place."""
        self.unet.to(device)
        self.log_snr = self.log_snr.to(device)
        if self.vae is not None:
            self.vae.to(device)
        if self.texts is not None:
            self.texts = self.texts.to(device)
        return self

    def encode(self, image: Image) -> Latent:
        """The autoencoder's code (its mean), in the scale that the UNet was trained on; or the image itself."""
        if self.vae is None:
            return image
        coded = self.vae.encode(image)
        code = coded.latent_dist.mode() if "latent_dist" in coded else coded.latents
        return code * self.vae.config["scaling_factor"]

    @torch.no_grad()
    def decode(self, latent: Latent) -> Image:
        if self.vae is None:
            return latent
        return self.vae.decode(latent / self.vae.config["scaling_factor"]).sample

    def predict_noise(
        self,
        z: Latent,
        t: Times,
        image: Image,
        mask: Mask,
        *,
        guidance: float = 1.0,
        noise_fill: Image | None = None,  # noqa: ARG002 - of `Denoiser`; these models are shown a grey hole
    ) -> Latent:
        """eps_hat(z_t; t, y), guided."""
        return guide_noise(
            lambda: self._predict_noise(z, t, image, mask, text=1),
            lambda: self._predict_noise(z, t, torch.zeros_like(image), torch.ones_like(mask), text=0),
            guidance,
        )

    @torch.no_grad()
    def _predict_noise(self, z: Latent, t: Times, image: Image, mask: Mask, text: int) -> Latent:
        shown = self._encode_known(torch.where(mask > 0, 0.0, image), text)
        # As these models are trained: a cell is in the hole where its first pixel is.
        holes = F.interpolate(mask, size=z.shape[-2:])
        seen = torch.cat([z, holes, shown], dim=1) if self.sees_mask else z
        given = {} if self.texts is None else {"encoder_hidden_states": self.texts[text].expand(len(z), -1, -1)}
        output = self.unet(seen, self.timestep(t), **given).sample
        noise = Parameterisation(self.kind, t).noise(output, z, z)
        if self.sees_mask:
            return noise
        # A cell that the hole touches is the hole's; what the others hold is known, and so is their noise.
        touched = F.adaptive_max_pool2d(mask, z.shape[-2:])
        return torch.where(touched > 0, noise, (z - per_image(alpha(t)) * shown) / per_image(sigma(t)))

    def _encode_known(self, known: Image, text: int) -> Latent:
        """The code of what is shown, kept: a sampler asks about one picture at every step, and encoding costs as much
        as the UNet.
        """
        before = self._shown.get(text)
        if before is None or before[0].device != known.device or not torch.equal(before[0], known):
            before = self._shown[text] = (known, self.encode(known))
        return before[1]

    def timestep(self, t: Times) -> Float[Tensor, "b"]:
        """The place in the model's own table of noise with the log SNR of t, between two rows; at most its ends."""
        falling = self.log_snr
        wanted = cosine_log_snr(t).clamp(falling[-1], falling[0])
        above = torch.searchsorted(-falling, -wanted, right=True).clamp(1, len(falling) - 1) - 1
        return above + (falling[above] - wanted) / (falling[above] - falling[above + 1])


def load_pipeline(place: str, prompt: str = "") -> PipelinePrior:
    """The prior of a pipeline in a local folder, or of a name in the hub's cache; nothing is downloaded.

    Raises ValueError where diffusers is not installed, the place holds no pipeline, or one that cannot be used.
    """
    try:
        from diffusers.pipelines.pipeline_utils import DiffusionPipeline
    except ImportError as error:
        raise ValueError(
            f"{place} needs diffusers, which is not installed; run `uv sync --extra diffusers --package "
            "inpaint3d-diffusion`"
        ) from error
    try:
        with warnings.catch_warnings(action="ignore"):  # about parts that are not used here
            pipeline = DiffusionPipeline.from_pretrained(
                place, local_files_only=True, use_safetensors=True, low_cpu_mem_usage=False, safety_checker=None
            )
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{place} is no folder of a diffusers pipeline with safetensors weights, nor in the hub's cache "
            f"({str(error).splitlines()[0]}); save it with pipeline.save_pretrained(FOLDER)"
        ) from error
    return PipelinePrior(pipeline, prompt)


def _encode_texts(pipeline: Any, prompt: str) -> Float[Tensor, "2 1 tokens width"] | None:
    """What the UNet is told: nothing and the prompt; None where it takes no text."""
    if "text_encoder" not in pipeline.components:
        return None
    if getattr(pipeline, "text_encoder_2", None) is not None:
        raise ValueError(f"{type(pipeline).__name__} has two text encoders; taken are pipelines with one or none")
    with torch.no_grad():
        return torch.stack([pipeline.encode_prompt(text, "cpu", 1, False)[0] for text in ("", prompt)])
