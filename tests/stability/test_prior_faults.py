"""Faults that are put into a prior's training: told by step and tensor, or by picture; what is kept is finite.

`FAULTS` is a table of docs/stability.md: what was put in, and what is said.
"""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from inpaint3d.contracts.errors import BadInputError, NonFiniteError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.diffusion.io import save_prior
from inpaint3d.diffusion.training import TrainingState, check_finite_weights
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.diffusion_training import teaching
from inpaint3d.stages.diffusion_training.config import Config
from inpaint3d.stages.diffusion_training.pictures import KnownPicture
from inpaint3d.stages.diffusion_training.teaching import begin_or_resume, lesson_of, train
from tests.room_artifacts import PRIOR

STEPS = 4
ROOM = synthetic_scene(views=3)
CONFIG = Config.model_validate({"steps": STEPS, "batch": 4, "exam": 2, "curve_rows": 2, "precision": "fp32"})


class Run(NamedTuple):
    """A training of a few steps on known pictures of the synthetic room, and what it says."""

    state: TrainingState
    pictures: list[KnownPicture]
    messages: list[str]


class Fault(NamedTuple):
    """put: does the damage after the second step, or before the last; early: before the first, since pictures are drawn
    ahead. survived: a step is lost, and no more.
    """

    what: str
    put: Callable[[Run], None]
    said: str
    survived: bool = False
    early: bool = False


def _first_weight(run: Run) -> torch.Tensor:
    return next(run.state.prior.parameters())


def set_weight(value: float) -> Callable[[Run], None]:
    def put(run: Run) -> None:
        with torch.no_grad():
            _first_weight(run).view(-1)[5] = value

    return put


def set_average(run: Run) -> None:
    with torch.no_grad():
        next(run.state.average.parameters()).view(-1)[5] = math.nan


def set_moment(run: Run) -> None:
    run.state.optimiser.state[_first_weight(run)]["exp_avg"].view(-1)[5] = math.nan


def break_gradient(value: float) -> Callable[[Run], None]:
    """The next gradient of a weight comes out broken in one number."""

    def put(run: Run) -> None:
        def spoil(gradient: torch.Tensor) -> torch.Tensor:
            handle.remove()
            spoilt = gradient.clone()
            spoilt.view(-1)[5] = value
            return spoilt

        handle = _first_weight(run).register_hook(spoil)

    return put


def break_picture(value: float) -> Callable[[Run], None]:
    """One colour of every picture, in the middle of it: which is drawn next, nobody knows."""

    def put(run: Run) -> None:
        for picture in run.pictures:
            height, width = picture.colour.shape[:2]
            picture.colour[height // 2, width // 2, 1] = value

    return put


FAULTS = [
    Fault(
        "NaN in a weight",
        set_weight(math.nan),
        r"step \d.* not finite: network\.noise\.network\.0\.weight \(1, the first at \[0, 5\]\)",
    ),
    Fault(
        "inf in a weight",
        set_weight(math.inf),
        r"step \d.* not finite: network\.noise\.network\.0\.weight \(1, the first at \[0, 5\]\)",
    ),
    Fault(
        "NaN in the average of the weights",
        set_average,
        r"not finite after step \d: average\.network\.noise\.network\.0\.weight \(1, the first at \[0, 5\]\)",
    ),
    Fault(
        "NaN in a moment of Adam",
        set_moment,
        r"not finite after step \d: prior\.network.*optimiser\.exp_avg\.network\.noise\.network\.0\.weight \(1, ",
    ),
    Fault(
        "NaN in a gradient",
        break_gradient(math.nan),
        r"step \d of .* not finite: gradient of network\.noise\.network\.0\.weight \(1, .*it moved nothing",
        survived=True,
    ),
    Fault(
        "inf in a gradient",
        break_gradient(-math.inf),
        r"step \d of .* not finite: gradient of network\.noise\.network\.0\.weight \(1, .*it moved nothing",
        survived=True,
    ),
    Fault(
        "NaN in a picture",
        break_picture(math.nan),
        r"picture view_\d+ holds \d+ numbers that are not finite",
        early=True,
    ),
    Fault(
        "inf in a picture",
        break_picture(math.inf),
        r"picture view_\d+ holds \d+ numbers that are not finite",
        early=True,
    ),
]


def run_training(work: Path, fault: Fault, at: int, precision: str) -> Run:
    """Trains and writes the prior; the fault comes when `at` steps are done."""

    class Watched(Context):
        def progress(self, done: float, total: float, message: str = "", **figures: float) -> None:
            if done == at and not fault.early:
                fault.put(run)

    messages: list[str] = []
    emit = lambda event, **values: messages.append(values.get("message", ""))  # noqa: E731
    ctx = Watched(seed=0, device="cpu", threads=1, work=work, emit=emit)
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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Fault, at: int, precision: str
) -> None:
    monkeypatch.setattr(teaching, "CHECKPOINT_S", 0.0)
    run = run_training(tmp_path, fault, at, precision)
    said = [message for message in run.messages if re.search(fault.said, message)]
    assert len(said) == 1, run.messages
    assert (tmp_path / "weights.safetensors").exists() == fault.survived
    if fault.early:
        return
    kept = load_file(tmp_path / "checkpoint.safetensors")
    check_finite_weights({name: tensor for name, tensor in kept.items() if "." in name})
    if fault.survived:
        assert f"step {at + 1} " in said[0]
        assert run.state.step == STEPS
        check_finite_weights(run.state.average.state_dict())
