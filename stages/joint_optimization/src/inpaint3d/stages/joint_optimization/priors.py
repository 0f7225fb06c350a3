"""The prior that an estimator asks: the trained one, or somebody else's."""

import torch

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.context import Inputs
from inpaint3d.contracts.models.artifacts import DiffusersPipeline, DiffusionPrior
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.diffusion.io import load_prior, open_prior
from inpaint3d.diffusion.pipelines import PipelinePrior, load_pipeline
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.stages.joint_optimization.config import WITHOUT_PRIOR, Config


def load_denoiser(config: Config, inputs: Inputs, device: str) -> Denoiser:
    """The diffusers pipeline, where one is wired, else the trained prior.

    Raises ConfigurationError where neither is wired or the estimator cannot use the one that is, BadInputError for a
    pipeline that cannot be asked.
    """
    wired = inputs.optional("diffusers-pipeline", DiffusersPipeline)
    if wired is None:
        return load_network(config, inputs, device).to(device)
    return load_foreign(config, wired).to(device)


def load_foreign(config: Config, wired: Artifact[DiffusersPipeline]) -> PipelinePrior:
    """A diffusers pipeline as a prior that the estimator can use. Errors as of `load_denoiser`."""
    try:
        prior = load_pipeline(str(wired.root / "pipeline"), config.prompt)
    except ValueError as error:
        raise BadInputError(f"diffusers-pipeline {wired.digest}: {error}") from error
    obstacle = {
        "vsd": "teaches the renders to a copy of its prior, which is done for the trained prior alone",
        "nfsd": None if prior.sees_mask else "compares two conditions, but this model is shown none",
    }.get(config.estimator)
    if obstacle:
        raise ConfigurationError(
            f"estimator {config.estimator!r} {obstacle}; the prior is the {wired.metadata.kind} at the input "
            "diffusers-pipeline: set another estimator (sds, sdi, ism, denoised-target, dataset-update, "
            "inpaint-then-nerf), or give no pipeline"
        )
    return prior


def load_network(config: Config, inputs: Inputs, device: str) -> InpaintingPrior:
    """The trained prior, in the runtime that it names; ConfigurationError where none is wired.

    A copy that learns (vsd) and a GPU take torch.
    """
    prior = inputs.optional("diffusion-prior", DiffusionPrior)
    if prior is None:
        raise ConfigurationError(
            f"estimator {config.estimator!r} needs an artifact at the input diffusion-prior; "
            f"wire one, or set estimator to one of {', '.join(WITHOUT_PRIOR)}"
        )
    if device == "cpu" and config.estimator != "vsd":
        return open_prior(prior, threads=torch.get_num_threads())
    return load_prior(prior.path(prior.metadata.weights), prior.metadata.spec)
