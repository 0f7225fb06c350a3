"""A stage behaves alike as a process and in a container: results, errors, signals, what is left behind."""

import csv
import itertools
import json
import os
import time
from pathlib import Path

import pytest

from inpaint3d.contracts.errors import RetryableError
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.stage import memory_bytes
from inpaint3d.contracts.store import FolderStore, Record
from inpaint3d.orchestrator.runners.container import STAGE_USER, Container, take_over
from tests.conftest import Cli
from tests.runners import PIPELINE, environment_of

UNTIL = "nerf-pretraining"
NODES = PIPELINE.order[: PIPELINE.order.index(UNTIL) + 1]


def arguments(capture):
    return ("run", str(capture), "--stub", "--until", UNTIL)


@pytest.fixture(params=["process", "engine", "podman"])
def any_cli(request, tmp_path):
    return Cli(tmp_path, environment_of(request.param, tmp_path))


@pytest.fixture
def engine(tmp_path):
    return Cli(tmp_path, environment_of("engine", tmp_path))


def outputs(cli):
    report = json.loads(cli("show", "tiny", "--json").stdout)
    return {s["node"]: s["outputs"] for s in report["stages"] if s["node"] in NODES}


def test_results_are_the_same_bytes_and_nothing_is_left_behind(any_cli, capture, tmp_path):
    result = any_cli(*arguments(capture))
    assert result.returncode == 0, result.stderr + result.stdout
    (tmp_path / "other").mkdir()
    process = Cli(tmp_path / "other")
    assert process(*arguments(capture)).returncode == 0
    assert outputs(any_cli) == outputs(process)
    compared = any_cli("compare", "tiny", "tiny", "--other-store", str(process.store))
    assert "equal" in compared.stdout
    assert compared.returncode == 3, "what is behind --until has no result in either"
    store = FolderStore(any_cli.store)
    damage = {d: store.find_damage(d) for d in store.objects()}
    assert len(damage) >= len(NODES)
    assert set(damage.values()) == {None}
    assert store.names("work") == store.names("tmp") == store.names("quarantine") == []
    assert "nothing to be done" in any_cli(*arguments(capture)).stderr


def test_stopped_it_goes_on(any_cli, capture):
    process = any_cli.start(*arguments(capture))
    while not list((any_cli.store / "runs").glob("tiny/*.json")):
        assert process.poll() is None, "the run ended before it began"
        time.sleep(0.05)
    process.terminate()
    assert process.wait(timeout=60) in (0, 143)
    assert any_cli(*arguments(capture)).returncode == 0


def test_killed_it_goes_on(any_cli, capture):
    process = any_cli.start(*arguments(capture))
    time.sleep(2)
    process.kill()
    process.wait()
    result = any_cli(*arguments(capture))
    assert result.returncode == 0, result.stderr
    assert any_cli("verify").returncode == 0


def test_an_error_of_the_stage_is_told_with_its_exit_code(any_cli, capture):
    (capture / "note.txt").rename(capture / "picture.jpg")  # it is no picture
    result = any_cli("run", str(capture), "--until", "capture-ingest")
    assert result.returncode == 3
    assert "picture.jpg" in result.stderr


def asked(cli):
    """Stage -> the options and mounts that the engine was given."""
    lines = [json.loads(line) for line in (cli.folder / "engine.log").read_text().splitlines()]
    runs = [line for line in lines if line[0] == "run"]
    found = {}
    for line in runs:
        image = next(part for part in line if part.startswith("images.example/"))
        pairs = list(itertools.pairwise(line))
        found[image.split("/")[-1].split(":")[0]] = (line, pairs, [v for k, v in pairs if k == "--mount"])
    return found


def test_what_a_container_may_do(engine, capture):
    assert engine(*arguments(capture)).returncode == 0
    found = asked(engine)
    assert list(found) == NODES
    user = STAGE_USER if os.getuid() == 0 else os.getuid()
    for node, (line, pairs, mounts) in found.items():
        stage = PIPELINE.stages[node].spec
        memory = f"{memory_bytes(stage.resources.limits['memory'])}b"
        for pair in [("--network", "none"), ("--pull", "never"), ("--cap-drop", "ALL"), ("--memory", memory),
                     ("--memory-swap", memory), ("--security-opt", "no-new-privileges")]:  # fmt: skip
            assert pair in pairs, (node, pair)
        assert "--read-only" in line
        assert next(v for k, v in pairs if k == "--user").startswith(f"{user}:")
        writable = [m for m in mounts if "readonly" not in m]
        assert len(writable) == 1
        assert "/work/" in writable[0], "the checkpoints' folder, never the store"
        ports = PIPELINE.references(node)
        required = [p for p in ports if not stage.inputs[p].optional]
        assert len(required) <= len(mounts) - 1 <= sum(map(len, ports.values()))
        assert all("/objects/" in m for m in mounts if "readonly" in m)


def test_the_image_stands_for_the_code(engine, capture):
    assert engine(*arguments(capture)).returncode == 0
    assert {r.components["code"] for r in FolderStore(engine.store).records()} == {"sha256:" + "ab" * 32}
    rows = json.loads(engine("plan", *arguments(capture)[1:], "--json").stdout)
    assert {r["status"] for r in rows if r["node"] in NODES} == {"cached"}


def test_killed_for_its_memory(engine, capture):
    engine.extra["ENGINE_FAULT"] = "137"
    result = engine(*arguments(capture))
    assert result.returncode == 137
    limit = PIPELINE.stages["capture-ingest"].spec.resources.limits["memory"]
    assert f"as a rule for its memory; its limit in a container is {limit}" in result.stderr


def test_an_engine_that_cannot_start_the_image(engine, capture):
    engine.extra["ENGINE_FAULT"] = "125"
    result = engine(*arguments(capture))
    assert result.returncode == 2
    assert (
        "could not start images.example/inpaint3d/capture-ingest:1 (exit 125); `make images` builds it" in result.stderr
    )


def test_no_engine_and_no_images_are_configuration_errors(engine, capture):
    assert engine(*arguments(capture), "--engine", "no-such-engine").returncode == 2
    result = engine(*arguments(capture), "--images", str(engine.folder / "none.yaml"))
    assert result.returncode == 2
    (engine.folder / "images.yaml").write_text("{apiVersion: inpaint3d/v1, kind: Images, spec: {}}")
    result = engine(*arguments(capture))
    assert result.returncode == 2
    assert "images.yaml has no inpaint3d/capture-ingest" in result.stderr


def test_a_container_that_missed_the_first_sigterm_is_asked_again(engine, capture):
    engine.extra["ENGINE_FAULT"] = "deaf"
    process = engine.start(*arguments(capture))
    while not (engine.folder / "engine.deaf").exists():
        assert process.poll() is None
        time.sleep(0.05)
    process.terminate()
    assert process.wait(timeout=30) == 143


def test_a_path_with_a_comma_is_no_option_of_a_mount():
    """Engines read a value of --mount as a line of CSV."""
    scratch, held = Path('/a,readonly/"b"'), Path("/c,target=/etc")
    container = Container("podman", "i", "sha256:0", "n", None, scratch, {"sha256:1": held}, cuda=False)
    line = container.command()
    mounts = list(csv.reader(value for option, value in itertools.pairwise(line) if option == "--mount"))
    assert mounts == [
        ["type=bind", f"source={scratch}", "target=/store"],
        ["type=bind", f"source={held}", "target=/store/objects/1", "readonly"],
    ]


def test_what_a_container_left_is_believed_only_as_its_digests_say(tmp_path):
    scratch, store = FolderStore(tmp_path / "scratch"), FolderStore(tmp_path / "store")
    folder = scratch.private_folder()
    (folder / "raw").mkdir()
    (folder / "raw" / "a.txt").write_text("a")
    digest = scratch.put(folder, "source", Source(name="x", kind="folder"))
    components = {"seed": 1}
    key = digest_of(components)
    scratch.commit(
        Record(key=key, stage="s@1", components=components, outputs={"capture": digest}, provenance={}, timings={})
    )  # fmt: skip
    written = scratch.object_path(digest) / "raw" / "a.txt"
    written.chmod(0o644)
    written.write_text("b")
    with pytest.raises(RetryableError, match="committed nothing"):
        take_over(scratch, store, key)
    assert list(store.objects()) == list(store.records()) == []
