"""Faults that are put into a fit: found, told by place, survived where they do not come again.

`FAULTS` is the table of docs/stability.md: what was put in, and what is said.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.health import check_finite
from inpaint3d.radiance.held_out import HeldOut
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.nerf_pretraining.config import Config
from inpaint3d.stages.nerf_pretraining.fit import Known, fit
from tests.stability.faults import (
    Fault,
    assert_checkpoint_is_finite,
    assert_located,
    break_next_gradient,
    set_number,
    watch,
)

SPEC = FieldSpec(
    grid=GridSpec(levels=3, coarsest=4, finest=16, log2_table=9, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(6,), samples=6, density_width=8, bottleneck=4, view_width=8, view_layers=1, near=0.05,
)  # fmt: skip
STEPS = 6
CONFIG = Config.model_validate({"steps": STEPS, "rays": 32, "first_rays": 32, "ramp_steps": 0, "score_every": 3})
SCENE = synthetic_scene(views=4)


class Run(NamedTuple):
    """A fit of a few steps on the synthetic room, and what it has to be told."""

    field: RadianceField
    known: Known
    ctx: Context
    messages: list[str]


def set_weight(name: str, value: float, at: tuple[int, int]) -> Callable[[Run], None]:
    return lambda run: set_number(_parameter(run, name), at, value)


def break_gradient(name: str, value: float) -> Callable[[Run], None]:
    return lambda run: break_next_gradient(_parameter(run, name), 3, value)


def _parameter(run: Run, name: str) -> torch.Tensor:
    return dict(run.field.named_parameters())[name]


def break_batch(part: str, value: float) -> Callable[[Run], None]:
    """The next draw of pixels has one colour, or one ray, that is not finite."""

    def put(run: Run) -> None:
        pixels, drawn = run.known.pixels, type(run.known.pixels).draw

        def draw(count: int, generator: torch.Generator) -> Any:
            if not pixels.__dict__.pop("again", False):
                pixels.__dict__.pop("draw")
            rays, target = drawn(pixels, count, generator)
            (target if part == "target" else rays.directions)[5, 1] = value
            return rays, target

        # Twice: the step, and that step again when it is traced.
        pixels.__dict__.update(draw=draw, again=True)

    return put


FAULTS = [
    Fault(
        "NaN in a dense entry of the table",
        set_weight("base.table", math.nan, (60, 1)),
        r"base\.table \(1, the first at \[60, 1\]",
    ),
    Fault(
        "inf in a rare entry of the table",
        set_weight("base.table", math.inf, (-1, 0)),
        r"base\.table \(1, the first at \[\d+, 0\]",
    ),
    Fault(
        "NaN in a network's weight",
        set_weight("base.weights.0", math.nan, (3, 2)),
        r"weights were not finite before the step: base\.weights\.0 \(1, the first at \[3, 2\]",
    ),
    Fault(
        "inf in the proposal's network",
        set_weight("proposal.weights.1", -math.inf, (0, 1)),
        r"proposal\.weights\.1 \(1, the first at \[0, 1\]",
    ),
    Fault(
        "NaN in a network of view-dependent colour",
        set_weight("specular.1", math.nan, (2, 2)),
        r"specular\.1 \(1, the first at \[2, 2\]",
    ),
    Fault("NaN in a table's gradient", break_gradient("base.table", math.nan), r"gradient\.base\.table \(1\)"),
    Fault(
        "inf in a network's gradient", break_gradient("base.weights.1", math.inf), r"gradient\.base\.weights\.1 \(1\)"
    ),
    Fault("a finite gradient of 1e25", break_gradient("base.weights.1", 1e25), r"gradient\.base\.weights\.1 \(1\)"),
    Fault(
        "NaN in a pixel's colour",
        break_batch("target", math.nan),
        r"loss\.reconstruction.*was given the first at \[5, 1\].*ray 5, view view_00\d, pixel \(\d+, \d+\)",
    ),
    Fault(
        "inf in a pixel's colour",
        break_batch("target", math.inf),
        r"loss\.reconstruction.*ray 5, view view_00\d, pixel \(\d+, \d+\)",
    ),
    Fault(
        "NaN in a ray's direction",
        break_batch("direction", math.nan),
        r"loss\..*ray 5, which itself is not finite \(origin \[.*\], direction \[.*nan",
    ),
]


def start(tmp_path: Path, fault: Fault[Run] | None, at: int, *, again: bool = False) -> Run:
    pixels = Pixels.of(SCENE.cameras, list(SCENE.images), [None] * 4)
    known = Known(pixels, None, list(zip(SCENE.names, SCENE.cameras, strict=True)))
    ctx, messages = watch(tmp_path, at, None if fault is None else lambda: fault.put(run), again=again)
    run = Run(RadianceField(SPEC, 0), known, ctx, messages)
    return run


def fit_it(run: Run, config: Config = CONFIG) -> None:
    fit(run.field, run.known, HeldOut([]), config, run.ctx)


@pytest.mark.parametrize("at", [2, STEPS - 1], ids=["third", "last"])
@pytest.mark.parametrize("fault", FAULTS, ids=[f.what for f in FAULTS])
def test_a_fault_that_comes_once_is_located_and_survived(tmp_path: Path, fault: Fault[Run], at: int) -> None:
    run = start(tmp_path, fault, at)
    fit_it(run)
    check_finite(run.field)
    assert run.ctx.health["rollbacks"] == 1
    assert len(run.messages) == 1
    assert_located(run.messages, fault.said, at)
    assert "goes on from step 0 with half the learning rate" in run.messages[0]


@pytest.mark.parametrize("fault", FAULTS[::2], ids=[f.what for f in FAULTS[::2]])
def test_a_fault_that_comes_again_ends_the_fit_with_its_place(tmp_path: Path, fault: Fault[Run]) -> None:
    run = start(tmp_path, fault, 2, again=True)
    with pytest.raises(NonFiniteError) as error:
        fit_it(run)
    assert_located([str(error.value)], fault.said, 2)
    assert "went back 1 times before" in str(error.value)
    assert_checkpoint_is_finite(tmp_path / "checkpoint.safetensors")


def test_a_fit_without_faults_never_goes_back(tmp_path: Path) -> None:
    run = start(tmp_path, None, 0)
    fit_it(run)
    assert run.messages == []
    assert run.ctx.non_finite == {}
    assert run.ctx.health["rollbacks"] == 0
    assert run.ctx.health["gradient_norm_largest"] > 0
