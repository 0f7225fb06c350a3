"""A run without a mask waits for one, says how to make it, and goes on when it is there; the page as a command."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest
import yaml

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import MaskSet
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import open_store
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.masks_cli import SHOWN, STAGE
from inpaint3d.orchestrator.stage_command import build_line, check_installed
from tests.conftest import REPOSITORY
from tests.page.room import build_room
from tests.sam_networks import write_networks

SPHERE = "mask: {kind: sphere, centre: [0, 0, 0], radius: 0.2}\n"


@pytest.fixture
def pipeline(cli, tmp_path):
    """mask-authoring alone, on the room as somebody else's artifacts."""
    room = build_room(tmp_path / "room", views=3)
    externals = {
        "capture": {"schema": "source@1"},
        "mask-request": {"schema": "mask-request@1", "optional": True},
        "segmenter": {"schema": "segmenter@1", "optional": True},
    }
    inputs = {"mask-request": "external.mask-request", "segmenter": "external.segmenter"}
    for name, digest in (("posed-capture", room.posed), ("radiance-field", room.field)):
        shutil.copytree(room.store.fetch(digest), tmp_path / name)
        externals[name] = {"schema": f"{name}@1", "default": name}
        inputs[name] = f"external.{name}"
    node = {"name": "mask-authoring", "stage": str(REPOSITORY / "stages/mask_authoring"), "inputs": inputs}
    spec = {
        "externals": externals,
        "stages": [node],
        "wants": ["mask-authoring"],
        "defaultPreset": "standard",
        "presets": {"standard": {}},
    }
    document = {"apiVersion": "inpaint3d/v1", "kind": "Pipeline", "metadata": {"name": "waiting"}, "spec": spec}
    (tmp_path / "schemas").symlink_to(REPOSITORY / "schemas")
    path = tmp_path / "pipeline.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def test_a_run_waits_for_a_mask_names_the_page_and_goes_on_with_what_it_saved(cli, capture, pipeline):
    arguments = ("run", str(capture), "--pipeline", str(pipeline))
    waiting = cli(*arguments)
    assert waiting.returncode == 4, waiting.stderr
    assert "mask-authoring waiting" in waiting.stderr
    command = f"inpaint3d masks edit tiny --store {cli.store} --runs-dir {cli.runs}"
    assert f"`{command}` opens a page" in waiting.stderr
    assert cli.statuses()["mask-authoring"] == "waiting"

    saved = cli.runs / "tiny" / "mask.yaml"
    saved.write_text(SPHERE)
    assert status_of(cli, *arguments[1:]) == "pending"
    done = cli(*arguments)
    assert done.returncode == 0, done.stderr
    assert f"what is to go is what {saved} says" in done.stderr
    assert mask_set_of(cli).origin == "sphere"


def test_a_mask_that_is_given_counts_more_than_one_that_was_saved(cli, capture, pipeline, tmp_path):
    (cli.runs / "tiny").mkdir(parents=True)
    (cli.runs / "tiny" / "mask.yaml").write_text("mask: {kind: imported}\n")
    (tmp_path / "given.yaml").write_text(SPHERE)
    given = cli("run", str(capture), "--pipeline", str(pipeline), "--mask", str(tmp_path / "given.yaml"))
    assert given.returncode == 0, given.stderr
    assert "what is to go is what" not in given.stderr
    assert mask_set_of(cli).origin == "sphere"


def test_objects_are_found_by_the_network_that_is_named_and_not_without_it(cli, capture, pipeline, tmp_path):
    (tmp_path / "request.yaml").write_text("mask: {kind: object, view: view_001, points: [[60, 45]]}\n")
    arguments = ("run", str(capture), "--pipeline", str(pipeline), "--mask", str(tmp_path / "request.yaml"))
    encoder, decoder = map(str, write_networks(tmp_path, "sam"))
    asked = cli(*arguments, "--segmenter", encoder, decoder)
    assert asked.returncode == 0, asked.stderr
    assert mask_set_of(cli).method.startswith("Segment Anything asked by points in view_001")
    assert status_of(cli, *arguments[1:], "--segmenter", encoder, decoder) == "cached"
    assert status_of(cli, *arguments[1:]) == "pending"


def test_files_that_are_no_segmenter_end_a_run_before_any_stage(cli, capture, pipeline, tmp_path):
    encoder, decoder = map(str, write_networks(tmp_path, "sam"))
    refused = cli("run", str(capture), "--pipeline", str(pipeline), "--segmenter", decoder, encoder)
    assert refused.returncode == 2
    assert f"--segmenter {encoder} is no decoder that can be asked: it takes input_image" in refused.stderr
    assert not list((Path(cli.store) / "keys").glob("*.json"))


def status_of(cli, *arguments):
    plan = json.loads(cli("plan", *arguments, "--json").stdout)
    (status,) = [node["status"] for node in plan if node["node"] == "mask-authoring"]
    return status


def mask_set_of(cli):
    store = open_store(str(cli.store))
    (node,) = [n for n in History(store).latest("tiny").nodes if n.node == "mask-authoring"]
    return store.open(node.outputs["mask-set"], MaskSet).metadata


def test_what_the_page_shows_of_a_run_is_what_mask_authoring_reads():
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml")
    read = pipeline.nodes["mask-authoring"].inputs
    for option, (node, port) in SHOWN.items():
        assert port in pipeline.stages[node].spec.outputs
        assert option == "capture" or read[option] == f"{node}.{port}"


def test_the_page_of_pictures_that_were_never_run_is_served_until_it_is_interrupted(cli, tmp_path):
    photos = REPOSITORY / "stages/capture_ingest/tests/tiny_source"
    named = ["--segmenter", *map(str, write_networks(tmp_path, "sam"))]
    line = cli.command("masks", "edit", str(photos), "--name", "tiny", *named)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(line, env=cli.environment(), cwd=REPOSITORY, start_new_session=True, **pipes) as process:
        try:
            assert process.stdout is not None
            url = next(m.group() for text in process.stdout if (m := re.search(r"http://\S+", text)))
            scene = fetch(f"{url}scene")
            assert len(scene["frames"]) == 4
            assert "Cameras are not known yet" in scene["missing"]
            places = f"--store {cli.store} --runs-dir {cli.runs}"
            assert scene["then"] == f"inpaint3d run {photos} --name tiny {' '.join(named)} {places}"
            assert scene["finder"] == "Segment Anything"
            assert Path(scene["file"]) == cli.runs / "tiny" / "mask.yaml"
            with pytest.raises(urllib.error.HTTPError, match="403"):
                fetch(re.sub(r"[^/]+/$", "scene", url))
        finally:
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        assert process.wait(20) == 0


def test_a_page_whose_stage_is_in_images_alone_is_refused():
    check_installed("inpaint3d.stages.mask_authoring")
    with pytest.raises(ConfigurationError, match=r"not installed in this environment .*containers have no network"):
        check_installed("inpaint3d.stages.mask_authoring_of_an_image")


def test_the_page_is_a_process_of_this_environment_where_stages_run_in_containers(monkeypatch):
    monkeypatch.setenv("INPAINT3D_RUNNER", "container")
    shown = {"capture": "sha256:a", "radiance-field": None, "segmenter": "sha256:b"}
    line = build_line(STAGE, "edit", "/store", shown, [])
    assert line[:4] == [sys.executable, "-m", "inpaint3d.stages.mask_authoring", "edit"]
    assert line[4:] == ["--store", "/store", "--die-with-parent", "--capture", "sha256:a", "--segmenter", "sha256:b"]


def fetch(url):
    with urllib.request.urlopen(url, timeout=20) as answer:  # noqa: S310 - the page's own
        return json.loads(answer.read())


def test_a_name_that_is_no_run_and_no_folder_is_told(cli):
    told = cli("masks", "edit", "no-such-run")
    assert told.returncode == 2
    assert "no run is called no-such-run" in told.stderr
