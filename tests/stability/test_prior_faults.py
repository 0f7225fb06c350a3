"""Faults that are put into a prior's training: told by step and tensor, or by picture; what is kept is finite.

`FAULTS` is a table of docs/stability.md: what was put in, and what is said.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch

from inpaint3d.contracts.errors import BadInputError, NonFiniteError
from inpaint3d.diffusion.io import save_prior
from inpaint3d.diffusion.training import TrainingState, check_finite_weights
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.diffusion_training import teaching
from inpaint3d.stages.diffusion_training.config import Config
from inpaint3d.stages.diffusion_training.pictures import KnownPicture
from inpaint3d.stages.diffusion_training.teaching import begin_or_resume, count_lost_step, lesson_of, train
from tests.room_artifacts import PRIOR
from tests.stability.faults import Fault, assert_checkpoint_is_finite, break_next_gradient, set_number, watch

STEPS = 4
ROOM = synthetic_scene(views=3)
CONFIG = Config.model_validate({"steps": STEPS, "batch": 4, "exam": 2, "curve_rows": 2, "precision": "fp32"})


class Run(NamedTuple):
    """A training of a few steps on known pictures of the synthetic room, and what it says."""

    state: TrainingState
    pictures: list[KnownPicture]
    messages: list[str]


@dataclass(frozen=True)
class PriorFault(Fault[Run]):
    """early: put in before the first step, since pictures are drawn ahead. survived: a step is lost, and no more."""

    survived: bool = False
    early: bool = False


def _first_weight(run: Run) -> torch.Tensor:
    return next(run.state.prior.parameters())


def set_weight(value: float) -> Callable[[Run], None]:
    return lambda run: set_number(_first_weight(run), 5, value)


def set_average(run: Run) -> None:
    set_number(next(run.state.average.parameters()), 5, math.nan)


def set_moment(run: Run) -> None:
    set_number(run.state.optimiser.state[_first_weight(run)]["exp_avg"], 5, math.nan)


def break_gradient(value: float) -> Callable[[Run], None]:
    return lambda run: break_next_gradient(_first_weight(run), 5, value)


def break_picture(value: float) -> Callable[[Run], None]:
    """One colour of every picture, in the middle of it: which is drawn next, nobody knows."""

    def put(run: Run) -> None:
        for picture in run.pictures:
            height, width = picture.colour.shape[:2]
            picture.colour[height // 2, width // 2, 1] = value

    return put


FAULTS = [
    PriorFault(
        "NaN in a weight",
        set_weight(math.nan),
        r"step \d.* not finite: network\.noise\.network\.0\.weight \(1, the first at \[0, 5\]\)",
    ),
    PriorFault(
        "inf in a weight",
        set_weight(math.inf),
        r"step \d.* not finite: network\.noise\.network\.0\.weight \(1, the first at \[0, 5\]\)",
    ),
    PriorFault(
        "NaN in the average of the weights",
        set_average,
        r"not finite after step \d: average\.network\.noise\.network\.0\.weight \(1, the first at \[0, 5\]\)",
    ),
    PriorFault(
        "NaN in a moment of Adam",
        set_moment,
        r"not finite after step \d: prior\.network.*optimiser\.exp_avg\.network\.noise\.network\.0\.weight \(1, ",
    ),
    PriorFault(
        "NaN in a gradient",
        break_gradient(math.nan),
        r"step \d of .* not finite: gradient of network\.noise\.network\.0\.weight \(1, .*it moved nothing",
        survived=True,
    ),
    PriorFault(
        "inf in a gradient",
        break_gradient(-math.inf),
        r"step \d of .* not finite: gradient of network\.noise\.network\.0\.weight \(1, .*it moved nothing",
        survived=True,
    ),
    PriorFault(
        "NaN in a picture",
        break_picture(math.nan),
        r"picture view_\d+ holds \d+ numbers that are not finite",
        early=True,
    ),
    PriorFault(
        "inf in a picture",
        break_picture(math.inf),
        r"picture view_\d+ holds \d+ numbers that are not finite",
        early=True,
    ),
]


def run_training(work: Path, fault: PriorFault, at: int, precision: str) -> Run:
    """Trains and writes the prior; the fault comes when `at` steps are done."""

    ctx, messages = watch(work, at, None if fault.early else lambda: fault.put(run))
    nothing = np.zeros(ROOM.images[0].shape[:2], bool)
    pictures = [
        KnownPicture(name, image * 2 - 1, nothing, nothing) for name, image in zip(ROOM.names, ROOM.images, strict=True)
    ]
    config = CONFIG.model_copy(update={"precision": precision})
    lesson = lesson_of(config, PRIOR, pictures, pictures, shapes=[ROOM.object_masks[0]])
    checkpoint = work / "checkpoint.safetensors"
    run = Run(begin_or_resume(config, PRIOR, None, ctx, checkpoint), pictures, messages)
    try:
        if fault.early:
            fault.put(run)
        train(run.state, config, lesson, ctx, checkpoint, fine_tuning=False)
        save_prior(work / "weights.safetensors", run.state.average)
    except (BadInputError, NonFiniteError) as error:
        messages.append(str(error))
    return run


# All in float32 at the third step; every second one at the last, and in bfloat16.
CASES = [
    *((fault, 2, "fp32") for fault in FAULTS),
    *((fault, STEPS - 1, "fp32") for fault in FAULTS[::2]),
    *((fault, 2, "bf16") for fault in FAULTS[::2]),
]


@pytest.mark.parametrize(("fault", "at", "precision"), CASES, ids=[f"{f.what}-{at}-{p}" for f, at, p in CASES])
def test_a_fault_of_training_is_located_and_never_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: PriorFault, at: int, precision: str
) -> None:
    monkeypatch.setattr(teaching, "CHECKPOINT_S", 0.0)
    run = run_training(tmp_path, fault, at, precision)
    said = [message for message in run.messages if re.search(fault.said, message)]
    assert len(said) == 1, run.messages
    assert (tmp_path / "weights.safetensors").exists() == fault.survived
    if fault.early:
        return
    assert_checkpoint_is_finite(tmp_path / "checkpoint.safetensors")
    if fault.survived:
        assert f"step {at + 1} " in said[0]
        assert run.state.step == STEPS
        check_finite_weights(run.state.average.state_dict())


def test_lost_steps_end_the_training_at_the_third_or_with_its_weights(tmp_path: Path) -> None:
    ctx, messages = watch(tmp_path, 0, None)
    state = begin_or_resume(CONFIG, PRIOR, None, ctx, tmp_path / "checkpoint.safetensors")
    state.pending = [0.5, math.nan, math.nan]
    count_lost_step(state, ctx)
    assert "it moved nothing" in messages[-1]
    state.pending.append(math.nan)
    with pytest.raises(NonFiniteError, match="3 steps in a row moved nothing"):
        count_lost_step(state, ctx)
    state.pending = [0.5, math.nan]
    set_number(next(state.prior.parameters()), 5, math.nan)
    with pytest.raises(NonFiniteError, match="1 steps in a row moved nothing"):
        count_lost_step(state, ctx)
