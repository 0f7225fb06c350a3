"""What accelerators run, torch.compile of the reference, on the CPU: the same numbers, compiled once for any count."""

import shutil
import subprocess
import sys

import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec
from inpaint3d.radiance.backends import Name, compiled, name_of, select
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.losses import interlevel_loss
from inpaint3d.radiance.rays import Rays
from inpaint3d.radiance.rendering import render

SPEC = FieldSpec.model_validate(
    {
        "proposal_grid": {"levels": 2, "coarsest": 4, "finest": 16, "log2_table": 8, "channels": 1},
        "grid": {"levels": 3, "coarsest": 4, "finest": 32, "log2_table": 9, "channels": 2},
        "proposal_samples": [8], "samples": 6, "density_width": 8, "bottleneck": 3, "view_width": 8, "view_layers": 1,
        "contraction": True, "bound": 1.0, "glo": 2, "glo_views": 3, "near": 0.1, "far": 20.0,
    }
)  # fmt: skip


def step(backend: Name, rays: int) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """Colours and gradients of a step of a field that is the same each time."""
    field = RadianceField(SPEC, seed=0, backend=backend)
    chance = torch.Generator().manual_seed(rays)
    directions = torch.nn.functional.normalize(torch.randn(rays, 3, generator=chance), dim=1)
    origins, views = torch.randn(rays, 3, generator=chance), torch.arange(rays) % 3
    seen = render(field, Rays(origins, directions, views), generator=torch.Generator().manual_seed(1))
    loss = seen.rgb.square().mean() + seen.depth.mean() + interlevel_loss(seen)
    return seen.rgb.detach(), list(torch.autograd.grad(loss, list(field.parameters())))


def compare() -> None:
    """Both versions of a step, for several counts of rays; after the first two nothing is compiled any more."""
    for rays in (64, 96, 33, 50, 128):
        torch.compiler.set_stance("default" if rays in (64, 96) else "fail_on_recompile")
        (colours, gradients), (wanted, truths) = step("compiled", rays), step("reference", rays)
        torch.testing.assert_close(colours, wanted, atol=1e-5, rtol=1e-5)
        for gradient, truth in zip(gradients, truths, strict=True):
            scale = max(1e-3, float(truth.abs().max()))
            torch.testing.assert_close(gradient, truth, atol=2e-5 * scale, rtol=1e-4)
        sys.stdout.write(f"{rays}\n")


def choose() -> None:
    """Where nothing can be compiled the reference is taken; that there is no such accelerator is reason enough."""
    works = compiled.can_compile("xla")
    names = name_of(select("xla")), name_of(select("cpu", "compiled"))
    sys.stdout.write(f"{works} {' '.join(names)}\n")


def said(part: str) -> list[str]:
    """What a part of this file says in a process of its own. torch.compile does not see through the type checks that
    tests run under, and what it imports changes where Python finds packages, and so what keys are taken over.
    """
    done = subprocess.run([sys.executable, __file__, part], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("c++") is None, reason="torch.compile needs a C++ compiler")
def test_a_step_is_the_reference_s_for_any_number_of_rays() -> None:
    """Forward and backward, through every operation that is compiled."""
    assert said("compare") == ["64", "96", "33", "50", "128"]


def test_an_accelerator_that_cannot_compile_gets_the_reference() -> None:
    assert said("choose") == ["False", "reference", "compiled"]


if __name__ == "__main__":
    {"compare": compare, "choose": choose}[sys.argv[1]]()
