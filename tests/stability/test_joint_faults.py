"""Faults that are put into the joint optimisation: told by step, tensor, ray, view or window, and gone back from.

`FAULTS` is a table of docs/stability.md: what was put in, and what is said.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.contracts.kit.context import Context, Inputs
from inpaint3d.contracts.models.documents import load_yaml
from inpaint3d.contracts.models.pipeline import merge_parameters
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import FolderStore
from inpaint3d.radiance.health import check_finite
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.curves import Curves
from inpaint3d.stages.joint_optimization.loop import optimise
from inpaint3d.stages.joint_optimization.parallel import Ranks
from inpaint3d.stages.joint_optimization.problem import Problem
from inpaint3d.stages.joint_optimization.run import pose
from tests.conftest import REPOSITORY
from tests.room_artifacts import put_completed, put_masks, put_plan, put_posed, put_prior
from tests.stability.faults import (
    Fault,
    assert_checkpoint_is_finite,
    assert_located,
    break_next_gradient,
    set_number,
    watch,
)

STAGE = REPOSITORY / "stages/joint_optimization"
STEPS = 4
ROOM = synthetic_scene(views=4)
ESTIMATORS: dict[str, dict[str, Any]] = {
    "sds": {"name": "sds", "warmup_steps": 0, "distill_every": 1},
    "completed-views": {"name": "completed-views", "patch_size": 16, "warmup_steps": 0, "distill_every": 1},
}


@dataclass(frozen=True)
class JointFault(Fault[Problem]):
    estimator: str = "sds"


def set_weight(name: str, value: float, at: tuple[int, int]) -> Callable[[Problem], None]:
    return lambda problem: set_number(_parameter(problem, name), at, value)


def break_gradient(name: str, value: float) -> Callable[[Problem], None]:
    return lambda problem: break_next_gradient(_parameter(problem, name), 3, value)


def _parameter(problem: Problem, name: str) -> torch.Tensor:
    return dict(problem.field.named_parameters())[name]


def break_batch(part: str, value: float) -> Callable[[Problem], None]:
    """The next batch, and the same when it is traced, has one number that is not finite: in a colour or a distance."""

    def put(problem: Problem) -> None:
        bank, drawn, left = problem.bank, problem.bank.draw, [2]

        def draw(*args: Any, **options: Any) -> Any:
            batch = drawn(*args, **options)
            left[0] -= 1
            if left[0] == 0:
                vars(bank).pop("draw")
            (batch.target[5, 1:2] if part == "target" else batch.distance[2:3]).fill_(value)
            return batch

        vars(bank)["draw"] = draw

    return put


def break_guide(value: float) -> Callable[[Problem], None]:
    """The guide's next answer has one number that is not finite in every pixel's place."""

    def put(problem: Problem) -> None:
        guide = problem.guide
        answer = type(guide).gradient

        def gradient(*args: Any) -> Any:
            vars(guide).pop("gradient")
            found, t = answer(guide, *args)
            return torch.full_like(found, value), t

        vars(guide)["gradient"] = gradient

    return put


def break_an_entry_that_no_ray_meets(value: float) -> Callable[[Problem], None]:
    """Of the last step's rays: what a step meets is known from its number alone."""

    def put(problem: Problem) -> None:
        terms, _ = problem.terms(problem.config.steps - 1, Ranks())
        (gradient,) = torch.autograd.grad(sum(terms.values(), torch.zeros(())), _parameter(problem, "base.table"))
        entry = int((gradient == 0).all(-1).nonzero()[0])
        set_number(_parameter(problem, "base.table"), (entry, 0), value)

    return put


FAULTS = [
    JointFault(
        "NaN in an entry of the table", set_weight("base.table", math.nan, (7, 1)), r"base\.table \(1, .*\[7, 1\]"
    ),
    JointFault(
        "inf in a network's weight", set_weight("base.weights.0", math.inf, (3, 2)), r"base\.weights\.0 \(1, .*\[3, 2\]"
    ),
    JointFault("NaN in a table's gradient", break_gradient("base.table", math.nan), r"gradient\.base\.table \(1\)"),
    JointFault(
        "inf in a network's gradient", break_gradient("base.weights.1", math.inf), r"gradient\.base\.weights\.1 \(1\)"
    ),
    JointFault(
        "NaN in a known pixel's colour",
        break_batch("target", math.nan),
        r"loss\.reconstruction.*was given the first at \[5, 1\].*ray 5, view view_\d+, pixel \(\d+, \d+\)",
    ),
    JointFault(
        "NaN in the distance of a sparse point",
        break_batch("distance", math.nan),
        r"loss\.line_of_sight.*was given the first at \[2, \d+\]|loss\.line_of_sight.*the first at \[2\]",
    ),
    JointFault(
        "NaN in the prior's answer",
        break_guide(math.nan),
        r"view view_\d+, window of \d+ px at .*the guide of view view_\d+ answered what is not finite",
    ),
    JointFault(
        "inf in the answer of a guide to completed pictures",
        break_guide(math.inf),
        r"view view_\d+, window of \d+ px at .*the guide of view view_\d+ answered what is not finite",
        "completed-views",
    ),
    JointFault(
        "inf in a known or a made-up pixel's colour",
        break_batch("target", math.inf),
        r"loss\.reconstruction.*ray 5, view view_\d+, pixel \(\d+, \d+\)",
        "completed-views",
    ),
]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Inputs:
    store = FolderStore(tmp_path_factory.mktemp("joint") / "store")
    wired = {
        "posed-capture": put_posed(store, ROOM, ROOM.images),
        "effect-plan": put_plan(store),
        "mask-set": put_masks(store, ROOM.names, ROOM.object_masks),
        "diffusion-prior": put_prior(store),
        "completed-views": put_completed(store, ROOM),
    }
    return Inputs(store, load_stage(STAGE / "stage.yaml"), wired)


def optimise_with(
    fault: JointFault, inputs: Inputs, work: Path, at: int, *, again: bool, **changes: Any
) -> tuple[Problem, Context, list[str]]:
    tiny = load_yaml(STAGE / "tests/tiny.yaml")[0]
    tiny.pop("estimator")
    changes |= {"steps": STEPS, "estimator": ESTIMATORS[fault.estimator]}
    config = Config.model_validate(merge_parameters(tiny, changes))
    problem, _ = pose(config, inputs, 0, "cpu")
    ctx, messages = watch(work, at, lambda: fault.put(problem), again=again)
    try:
        optimise(problem, ctx, Curves(), Ranks())
    except NonFiniteError as error:
        messages.append(str(error))
    return problem, ctx, messages


@pytest.mark.parametrize("at", [2, STEPS - 1], ids=["third", "last"])
@pytest.mark.parametrize("fault", FAULTS, ids=[f.what for f in FAULTS])
def test_a_fault_that_comes_once_is_located_and_survived(
    tmp_path: Path, inputs: Inputs, fault: JointFault, at: int
) -> None:
    problem, ctx, messages = optimise_with(fault, inputs, tmp_path, at, again=False)
    check_finite(problem.field)
    assert ctx.health["rollbacks"] == 1
    assert_located(messages, fault.said, at)
    assert "goes on from step 0 with half the learning rate" in messages[-1]


@pytest.mark.parametrize("fault", FAULTS[::3], ids=[f.what for f in FAULTS[::3]])
def test_a_fault_that_comes_again_ends_with_its_place(tmp_path: Path, inputs: Inputs, fault: JointFault) -> None:
    _, _, messages = optimise_with(fault, inputs, tmp_path, 2, again=True)
    assert_located(messages, fault.said, 2)
    assert "went back 1 times before" in messages[-1]
    assert_checkpoint_is_finite(tmp_path / "checkpoint.safetensors")


def test_an_entry_that_the_last_step_does_not_meet_is_found_before_it_is_kept(tmp_path: Path, inputs: Inputs) -> None:
    # Adam reports every number that it is to move; with sparse_adam those that were met, alone.
    fault = JointFault("", break_an_entry_that_no_ray_meets(math.nan), r"after step 4: base\.table \(1, .*\[\d+, 0\]")
    sparse = {"optimizer": {"sparse_adam": True}}
    problem, ctx, messages = optimise_with(fault, inputs, tmp_path, STEPS - 1, again=False, **sparse)
    check_finite(problem.field)
    assert ctx.health["rollbacks"] == 1
    assert_located(messages, fault.said, STEPS - 1)
    assert "non-finite values at step" not in messages[0]
