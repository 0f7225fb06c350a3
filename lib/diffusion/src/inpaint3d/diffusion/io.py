"""Priors on disk: weights as safetensors; the spec travels beside them, in the artifact."""

from pathlib import Path

import torch
from safetensors.torch import load_file, save

from inpaint3d.contracts.models.artifacts.prior import DiffusionPrior, PriorSpec
from inpaint3d.contracts.models.untrusted import read_safetensors_header
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.runtimes import load_onnx
from inpaint3d.diffusion.training import check_finite_weights
from inpaint3d.scene.finite import find_non_finite


def save_prior(path: Path, prior: InpaintingPrior, *, half: bool = False) -> None:
    """Write the weights; the same weights give the same bytes. half: as float16, for files that travel.

    NonFiniteError where one is not finite, in the format that it is written in.
    """
    dtype = torch.float16 if half else torch.float32
    # One sorted, contiguous layout: memory formats (channels last) must not change the bytes.
    weights = {
        name: tensor.detach().to(dtype=dtype, memory_format=torch.contiguous_format).contiguous().cpu()
        for name, tensor in sorted(prior.state_dict().items())
    }
    check_finite_weights(weights)
    path.write_bytes(save(weights))


def load_prior(path: Path, spec: PriorSpec, *, bf16: bool = False) -> InpaintingPrior:
    """The prior of these weights, in float32, ready to be queried (no gradients).

    Raises ValueError where the weights are not those of the spec, or not all finite.
    """
    read_safetensors_header(path)
    prior = InpaintingPrior(spec, bf16=bf16)
    weights = {name: tensor.float() for name, tensor in load_file(path).items()}
    if strange := find_non_finite({name: tensor.numpy() for name, tensor in weights.items()}):
        raise ValueError(f"{path} holds weights that are not finite: {', '.join(map(str, strange))}")
    try:
        prior.load_state_dict(weights)
    except RuntimeError as error:
        raise ValueError(f"{path} does not hold the weights of {spec!r}: {error}") from error
    return prior.eval().requires_grad_(False)


def open_prior(prior: Artifact[DiffusionPrior], *, threads: int = 1) -> InpaintingPrior:
    """The prior of an artifact in the runtime that it names, ready to be queried. ValueError as of `load_prior`."""
    metadata = prior.metadata
    if metadata.runtime == "onnxruntime" and metadata.onnx is not None:
        return load_onnx(prior.path(metadata.onnx), metadata.spec, threads)
    return load_prior(prior.path(metadata.weights), metadata.spec)
