"""The prior that a stage asks: the trained one, or somebody else's pipeline."""

import torch

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.context import Inputs
from inpaint3d.contracts.models.artifacts import DiffusersPipeline, DiffusionPrior
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.diffusion.io import load_prior, open_prior
from inpaint3d.diffusion.pipelines import PipelinePrior, load_pipeline
from inpaint3d.diffusion.prior import InpaintingPrior, bf16_pays


def load_denoiser(inputs: Inputs, *, asker: str, prompt: str, device: str, trainable: bool = False) -> Denoiser:
    """The prior at the port diffusers-pipeline, where one is wired, else the trained one at diffusion-prior.

    asker: who asks, for errors. prompt: what a pipeline that takes text is told. trainable: a copy of it learns, which
    needs torch. Raises ConfigurationError where neither is wired, BadInputError for a pipeline that cannot be asked.
    """
    wired = inputs.optional("diffusers-pipeline", DiffusersPipeline)
    if wired is None:
        return load_trained_prior(inputs, asker=asker, device=device, trainable=trainable).to(device)
    return load_diffusers_pipeline(wired, prompt).to(device)


def load_diffusers_pipeline(wired: Artifact[DiffusersPipeline], prompt: str) -> PipelinePrior:
    """A diffusers pipeline as a prior. BadInputError for one that cannot be asked."""
    try:
        return load_pipeline(str(wired.root / "pipeline"), prompt)
    except ValueError as error:
        raise BadInputError(f"diffusers-pipeline {wired.digest}: {error}") from error


def load_trained_prior(inputs: Inputs, *, asker: str, device: str, trainable: bool) -> InpaintingPrior:
    """The trained prior, in the runtime that it names; a copy that learns and a GPU take torch, a GPU in bf16."""
    prior = inputs.optional("diffusion-prior", DiffusionPrior)
    if prior is None:
        raise ConfigurationError(
            f"{asker} asks a prior, and nothing is wired to its inputs diffusion-prior and diffusers-pipeline; "
            "wire one of them, or choose one that asks none"
        )
    if device == "cpu" and not trainable:
        return open_prior(prior, threads=torch.get_num_threads())
    bf16 = device != "cpu" and bf16_pays(device)
    return load_prior(prior.path(prior.metadata.weights), prior.metadata.spec, bf16=bf16)
