"""Part 1: what runs on the device gives what the processor gives. Each check says its error and what it may be."""

import argparse
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from benchmarks.gpu.results import Results
from benchmarks.gpu.room import fit_for, room_fit
from benchmarks.provenance import REPOSITORY
from torch import Tensor

from inpaint3d.contracts.models.artifacts import PriorSpec
from inpaint3d.diffusion.distillation import PriorQuery, sds_gradient
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.training import Batch, begin, denoising_loss, train_step
from inpaint3d.radiance import backends
from inpaint3d.radiance.rendering import render
from inpaint3d.radiance.training import regularisers
from inpaint3d.stages.view_completion.example import fill_by_example

KERNELS = ("hash_encode", "mlp", "adam")
COMPILING_S = 120.0
"""What compiling a prior's network, forwards and backwards, may take."""
FLOAT32, BF16 = 2e-3, 6e-2
"""Largest share by which an answer may be off: sums in another order, and products of 8 bits."""
SMALL = PriorSpec(
    size=32, width=32, multipliers=(1, 2), blocks=(1, 1), attention=(False, True), packing=2, condition="mask-channel",
    known="clean", loss_region="hole", prediction="residual", residual_bands=(0.1, 0.25, 0.6, 1.3),
)  # fmt: skip


def measure(options: argparse.Namespace, results: Results) -> None:
    device = options.device
    if device == "cpu":
        torch.set_num_threads(1)
    # What is compared is what is computed; TF32, cuDNN's default for convolutions, would hide a wrong third digit.
    torch.backends.cudnn.allow_tf32 = False
    checks: dict[str, Callable[[], Any]] = {
        "prior, float32": lambda: compare_prior(device, bf16=False),
        "prior, bfloat16 and channels last": lambda: compare_prior(device, bf16=True),
        "score distillation": lambda: compare_distillation(device),
        "training step of the prior": lambda: learn(device),
        "filling by example": lambda: compare_example(device),
        **{f"kernels of the field, {name}": lambda n=name: compare_kernel(n, device) for name in KERNELS},
        "field, eager": lambda: compare_field(device, "reference"),
        "field, as it is chosen": lambda: compare_field(device, None),
        "a room is learnt": lambda: compare_fits(device, options.tiny),
        "prior, compiled": lambda: compare_prior(device, bf16=False, compiled=True),
    }
    if device == "cpu" or options.tiny:
        del checks["prior, compiled"]
    for name, check in checks.items():
        results.attempt(name, check, needs_s=COMPILING_S if "compiled" in name else 1.0)


def error_of(made: Tensor, truth: Tensor) -> float:
    """Length of the difference as a share of the truth's."""
    truth = truth.double()
    return float((made.detach().cpu().double() - truth).norm() / truth.norm().clamp(min=1e-12))


def verdict(error: float, allowed: float, **also: Any) -> dict[str, Any]:
    return {"error": float(f"{error:.3g}"), "allowed": allowed, "ok": bool(error <= allowed), **also}


def batch_of(spec: PriorSpec, count: int) -> Batch:
    chance = torch.Generator().manual_seed(0)
    coarse = torch.rand(count, 3, 4, 4, generator=chance) * 2 - 1
    image = F.interpolate(coarse, (spec.size, spec.size), mode="bilinear")
    hole = torch.zeros(count, 1, spec.size, spec.size)
    hole[..., spec.size // 4 : spec.size // 2, spec.size // 4 :] = 1
    return Batch(image, hole, torch.ones_like(hole))


def stirred(prior: InpaintingPrior) -> InpaintingPrior:
    """A prior whose layers that start at zero do not: nothing else is a test of the layers before them."""
    chance = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in prior.parameters():
            parameter += 0.02 * torch.randn(parameter.shape, generator=chance).to(parameter)
    return prior


def compare_prior(device: str, *, bf16: bool, compiled: bool = False) -> dict[str, Any]:
    """Its loss and the gradients of its weights, noise from the processor."""
    here, there = (stirred(InpaintingPrior(SMALL, seed=0, bf16=b)) for b in (False, bf16))
    there = there.to(device)
    if bf16:
        there = there.to(memory_format=torch.channels_last)
    if compiled:
        there.network.compile()
    found = []
    for prior, where in ((here, "cpu"), (there, device)):
        loss = denoising_loss(prior, batch_of(SMALL, 4).to(where), torch.Generator().manual_seed(2))
        gradients = torch.autograd.grad(loss, list(prior.parameters()))
        found.append(torch.cat([loss.detach().reshape(1), *(g.flatten() for g in gradients)]))
    return verdict(error_of(found[1], found[0].cpu()), BF16 if bf16 else FLOAT32)


def compare_distillation(device: str) -> dict[str, Any]:
    batch, chance = batch_of(SMALL, 1), torch.Generator().manual_seed(3)
    eps = torch.randn(batch.image.shape, generator=chance)
    answers = []
    for where in ("cpu", device):
        prior = stirred(InpaintingPrior(SMALL, seed=0)).to(where)
        query = PriorQuery(
            batch.image.to(where), batch.hole.to(where), torch.tensor([0.6], device=where), eps.to(where)
        )
        answers.append(sds_gradient(prior, query, guidance=2.0))
    return verdict(error_of(answers[1], answers[0]), FLOAT32)


def learn(device: str) -> dict[str, Any]:
    """Twenty steps on one batch and one noise with fused Adam: the loss falls, and is finite."""
    state = begin(SMALL, 0, bf16=device != "cpu", channels_last=device != "cpu", device=device)
    batch = batch_of(SMALL, 4).to(device)

    def loss_of(prior: InpaintingPrior) -> Tensor:
        return denoising_loss(prior, batch, torch.Generator(device).manual_seed(0))

    losses = [train_step(state, loss_of, learning_rate=2e-3) for _ in range(20)]
    first, last = float(np.mean(losses[:5])), float(np.mean(losses[-5:]))
    return verdict(last / first, 0.97, first=round(first, 4), last=round(last, 4))


def compare_example(device: str) -> dict[str, Any]:
    """The mean difference of colours, of which the last bits decide between patches that are alike."""
    rows, columns = np.mgrid[:64, :64]
    image = (0.5 + 0.4 * np.stack([np.sin(rows / 5), np.cos(columns / 7), np.sin((rows + columns) / 9)], -1)).astype(
        "f4"
    )
    hole = (rows - 34) ** 2 + (columns - 28) ** 2 < 12**2
    here, there = (fill_by_example(image, hole, ~hole, device=where)[0] for where in ("cpu", device))
    return verdict(float(np.abs(here - there)[hole].mean()), 0.02)


def compare_kernel(name: str, device: str) -> dict[str, Any]:
    if importlib.util.find_spec("triton") is None:
        return {"skipped": "Triton is not installed"}
    if device == "cpu":
        return {"skipped": "kernels run on GPUs; interpreted, they are compared in lib/radiance/tests/triton_run.py"}
    path = REPOSITORY / "lib" / "radiance" / "tests" / "triton_run.py"
    spec = importlib.util.spec_from_file_location("triton_run", path)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(path)
    tests = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tests)
    tests.compare(name, device)
    return {"ok": True, "allowed": tests.CLOSE["atol"]}


def compare_field(device: str, backend: backends.Name | None) -> dict[str, Any]:
    """Colours, and the gradient of a step's loss by the field's numbers, samples jittered alike."""
    found = []
    for where, name in (("cpu", "reference"), (device, backend)):
        fit = room_fit(where, tiny=True, backend=name)
        rays, target = fit.known.pixels.draw(64, torch.Generator().manual_seed(1))
        seen = render(fit.field, rays, generator=torch.Generator().manual_seed(0))
        terms = {"colours": (seen.rgb - target).square().mean(), **regularisers(seen, fit.config.loss_weights)}
        gradients = torch.autograd.grad(torch.stack(list(terms.values())).sum(), list(fit.field.parameters()))
        found.append(
            torch.cat([seen.rgb.detach().flatten(), *(g.flatten() / g.norm().clamp(min=1e-12) for g in gradients)])
        )
        chosen = backends.name_of(fit.field.backend)
    return verdict(error_of(found[1], found[0].cpu()), FLOAT32, backend=chosen)


def compare_fits(device: str, tiny: bool) -> dict[str, Any]:
    """Held-out PSNR of a field after some steps, dB: noise is another on a GPU, quality is not."""
    steps = 30 if tiny else 150
    here, there = (fit_for(room_fit(where, tiny=True), steps) for where in ("cpu", device))
    return verdict(abs(here - there), 1.0, processor=round(here, 2), device=round(there, 2))
