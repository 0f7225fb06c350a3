"""Row S12, with two gloo ranks."""

import io
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from pydantic import ValidationError

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.context import Inputs
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import RadianceFieldArtifact
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import Store
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.optim import Adam, learning_rate
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.parallel import Ranks
from inpaint3d.stages.joint_optimization.rank import step_along
from inpaint3d.stages.joint_optimization.run import pose

TINY = yaml.safe_load((Path(__file__).parent / "tiny.yaml").read_text()) | {"steps": 5}


def test_two_ranks_step_along_the_mean_of_their_gradients(store: Store, inputs: Callable[..., dict[str, Any]]) -> None:
    """Five steps, the last three distilled, equal both ranks' gradients taken in turn in one process and averaged."""
    wired, parameters = inputs(), TINY | {"ranks": 2}
    invocation = Invocation(inputs=wired, parameters=parameters, threads=1)
    record = execute("inpaint3d.stages.joint_optimization", store, invocation, io.StringIO())
    result = store.open(record.outputs["radiance-field"], RadianceFieldArtifact)
    got = load_field(result.path("weights.safetensors"), result.metadata.spec)

    config = Config.model_validate(parameters)
    spec = load_stage(Path(__file__).parents[1] / "stage.yaml")
    problem, _ = pose(config, Inputs(store, spec, wired), 0, "cpu")
    field, before = problem.field, [p.detach().clone() for p in problem.field.parameters()]
    optimizer = Adam(field, hash_decay=config.loss_weights.hash_decay)
    for step in range(config.steps):
        for parameter in field.parameters():
            parameter.grad = None
        patches = []
        for rank in (0, 1):
            terms, figures = problem.terms(step, Ranks(rank, 2))
            (torch.stack(list(terms.values())).sum() / 2).backward()  # gradients add up
            patches.append(figures.get("t"))
        assert step < 2 or patches[0] != patches[1], "each rank has a patch of its own"
        rate = learning_rate(
            step, initial=1e-2, final=1e-3, steps=config.steps, warmup=config.optimizer.learning_rate_warmup
        )
        optimizer.step(rate)
    for name, parameter in field.named_parameters():
        torch.testing.assert_close(got.get_parameter(name), parameter)
    moved = max(float((a - b.detach()).abs().max()) for a, b in zip(before, field.parameters(), strict=True))
    assert moved > 1e-3


def test_ranks_of_torchrun_give_what_the_stage_s_own_ranks_do(
    store: Store, inputs: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    """The same digest under the same key, whether the second rank was spawned by the first or started beside it."""
    invocation = Invocation(inputs=inputs(), parameters=TINY | {"ranks": 2}, threads=2)
    record = execute("inpaint3d.stages.joint_optimization", store, invocation, io.StringIO())
    store.forget(record.key)
    (tmp_path / "invocation.json").write_text(invocation.model_dump_json())
    line = [
        sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2",
        "-m", "inpaint3d.stages.joint_optimization.rank",
        "run", "--store", store.place, "--invocation", str(tmp_path / "invocation.json"),
    ]  # fmt: skip
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    events = [json.loads(text) for text in done.stdout.splitlines() if text.startswith("{")]
    assert any(e["event"] == "progress" for e in events), "computed again"
    assert {e["stage"] for e in events} == {"joint-optimization"}
    assert [e["outputs"] for e in events if e["event"] == "done"] == [record.outputs]
    assert store.lookup(record.key) is not None


def test_another_number_of_processes_than_ranks_is_refused(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"RANK": 1, "WORLD_SIZE": 3, "LOCAL_RANK": 1, "LOCAL_WORLD_SIZE": 3}.items():
        monkeypatch.setenv(name, str(value))
    with pytest.raises(ConfigurationError, match="started 3 processes, the parameter ranks says 2"):
        step_along(store, Invocation(parameters=TINY | {"ranks": 2}))


def test_rays_are_shared_out(store: Store, inputs: Callable[..., dict[str, Any]]) -> None:
    """N8: the number of rays is that of all devices together; S12: patches are each rank's own."""
    config = Config.model_validate(TINY)
    spec = load_stage(Path(__file__).parents[1] / "stage.yaml")
    problem, _ = pose(config, Inputs(store, spec, inputs()), 0, "cpu")
    drawn: list[int] = []
    draw = problem.bank.draw
    problem.bank.draw = lambda count, **options: drawn.append(count) or draw(count, **options)
    for rank in (0, 1):
        problem.terms(0, Ranks(rank, 2))
    assert drawn == [32, 32]
    with pytest.raises(ValidationError, match="multiple"):
        Config.model_validate(TINY | {"ranks": 3})
