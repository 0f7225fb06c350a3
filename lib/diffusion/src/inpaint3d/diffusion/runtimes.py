"""A prior's network outside torch: exported to ONNX, run by onnxruntime, timed against torch."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from inpaint3d.contracts.models.artifacts.prior import PriorSpec
from inpaint3d.diffusion.prior import InpaintingPrior, input_channels

OPSET = 20


def export_onnx(path: Path, prior: InpaintingPrior) -> None:
    """Write the network as ONNX, for any batch of pictures of the prior's own size.

    Raises ValueError where onnx and onnxscript are not installed.
    """
    size = prior.spec.size
    # Two pictures: a batch of one would be taken for a constant.
    example = (torch.zeros(2, input_channels(prior.spec), size, size), torch.zeros(2))
    try:
        torch.onnx.export(
            prior.network.eval(),
            example,
            path,
            input_names=["shown", "log_snr"],
            output_names=["output"],
            dynamic_shapes=({0: torch.export.Dim.AUTO}, {0: torch.export.Dim.AUTO}),
            opset_version=OPSET,
            external_data=False,
            dynamo=True,
            verbose=False,
        )
    except ImportError as error:
        raise ValueError(f"cannot export to ONNX: {error}; {_INSTALL}") from error


def load_onnx(path: Path, spec: PriorSpec, threads: int = 1) -> InpaintingPrior:
    """The prior of an exported network, queried like any other; ValueError where onnxruntime refuses the file."""
    return InpaintingPrior(spec, network=OnnxNetwork(path, threads)).eval()


class OnnxNetwork(nn.Module):
    """An exported network in the place of an EfficientUNet. It has no gradients."""

    def __init__(self, path: Path, threads: int) -> None:
        super().__init__()
        try:
            import onnxruntime
        except ImportError as error:
            raise ValueError(f"{path} needs onnxruntime: {error}; {_INSTALL}") from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        try:
            self.session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's own exceptions have no common base
            raise ValueError(f"{path} is not a network that onnxruntime can run ({error}); export it again") from error

    def forward(self, shown: Float[Tensor, "b c h w"], log_snr: Float[Tensor, "b"]) -> Float[Tensor, "b o h w"]:
        inputs = {"shown": shown.numpy(), "log_snr": log_snr.numpy()}
        return torch.from_numpy(np.asarray(self.session.run(None, inputs)[0]))


def seconds_per_query(prior: InpaintingPrior, repeats: int = 5) -> float:
    """Wall seconds of one denoising step of one picture: the best of some, after one to warm up."""
    size = prior.spec.size
    picture, mask = torch.zeros(1, 3, size, size), torch.zeros(1, 1, size, size)
    mask[..., size // 4 : 3 * size // 4, size // 4 : 3 * size // 4] = 1
    t = torch.full((1,), 0.5)
    with torch.no_grad():
        return best_seconds(
            lambda: prior.predict_noise(torch.zeros_like(picture), t, picture, mask, noise_fill=picture), repeats
        )


def best_seconds(work: Callable[[], object], repeats: int) -> float:
    """Wall seconds of some work: the least of `repeats`, after one time that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


_INSTALL = "run `uv sync --extra onnx --package inpaint3d-diffusion`"
