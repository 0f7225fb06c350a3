"""How a run ends that nobody meant to end so, and two runs that want the same: with real processes."""

import ctypes
import json
import os
import signal
import stat
import subprocess
import time

import pytest

from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.housekeeping import find_damage

INGEST = ("--stub", "--until", "capture-ingest")


def last_run(cli, name="tiny"):
    return History(FolderStore(cli.store)).latest(name)


def test_a_closed_standard_output_stops_the_run_and_its_record_says_so(cli, capture):
    reader, writer = os.pipe()
    os.close(reader)
    process = subprocess.Popen(
        cli.command("run", str(capture), *INGEST), stdout=writer, stderr=subprocess.PIPE, text=True,
        env=cli.environment(),
    )  # fmt: skip
    os.close(writer)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 143, errors
    assert "nobody reads standard output any more" in errors
    assert "Traceback" not in errors
    record = last_run(cli)
    assert (record.status, record.error) == ("stopped", "nobody reads standard output any more")
    assert record.finished is not None
    assert json.loads((cli.runs / "tiny" / "metrics.json").read_text())["status"] == "stopped"
    assert cli("run", str(capture), *INGEST).returncode == 0


def test_a_run_that_dies_in_planning_has_a_record_that_says_of_what(cli, capture):
    FolderStore(cli.store)
    (cli.store / "keys").write_text("no folder")
    result = cli("run", str(capture), *INGEST)
    assert result.returncode == 5, result.stderr
    assert "move away what is in its place" in result.stderr
    record = last_run(cli)
    assert record.status == "failed"
    assert "keys" in record.error
    assert json.loads((cli.runs / "tiny" / "metrics.json").read_text())["status"] == "failed"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_no_run_stays_running_for_ever(cli, capture, number):
    process = cli.start("run", str(capture), *INGEST)
    while not list((cli.store / "runs").glob("tiny/*.json")):
        assert process.poll() is None, "the run ended before it began"
        time.sleep(0.02)
    process.send_signal(number)
    process.wait(timeout=60)
    assert cli("run", str(capture), *INGEST).returncode == 0
    assert "running" not in {r.status for r in History(FolderStore(cli.store)).of("tiny")}


def test_a_name_that_another_capture_has_is_not_taken_from_it(cli, tmp_path):
    """Folders of photos are often called `images`."""
    for room in ("kitchen", "hall"):
        (tmp_path / room / "images").mkdir(parents=True)
        (tmp_path / room / "images" / "note.txt").write_text(room)
    kitchen, hall = (str(tmp_path / room / "images") for room in ("kitchen", "hall"))
    assert cli("run", kitchen, *INGEST).returncode == 0
    before = (cli.runs / "images" / "metrics.json").read_text()
    refused = cli("run", hall, *INGEST)
    assert refused.returncode == 2
    assert "--name images: its last run" in refused.stderr
    assert "--name OTHER, or --replace" in refused.stderr
    assert (cli.runs / "images" / "metrics.json").read_text() == before
    assert cli("run", hall, *INGEST, "--name", "hall").returncode == 0
    assert cli("run", hall, *INGEST, "--replace").returncode == 0
    assert cli("run", kitchen, *INGEST).returncode == 2


def test_of_two_runs_of_one_name_the_second_refuses_or_waits(cli, capture):
    """The first is halted while it holds the folder, so that the second cannot come too late."""
    first = cli.start("run", str(capture), *INGEST)
    while not (cli.runs / "tiny" / ".lock").exists() or not (cli.runs / "tiny" / ".lock").read_text():
        assert first.poll() is None, "the run ended before it began"
        time.sleep(0.02)
    first.send_signal(signal.SIGSTOP)
    refused = cli("run", str(capture), *INGEST)
    waiting = cli.start("run", str(capture), *INGEST, "--wait")
    first.send_signal(signal.SIGCONT)
    assert refused.returncode == 75
    assert f"process {first.pid} on " in refused.stderr
    assert [first.wait(timeout=120), waiting.wait(timeout=120)] == [0, 0]
    assert [r.status for r in History(FolderStore(cli.store)).of("tiny")] == ["done", "done"]
    assert list(find_damage(FolderStore(cli.store))) == []


def obey_rights() -> None:
    """Take from the process what lets root write everywhere (CAP_DAC_OVERRIDE); for others nothing changes."""
    ctypes.CDLL(None).prctl(24, 1, 0, 0, 0)


def test_what_is_cached_can_be_had_from_a_store_that_cannot_be_written(cli, capture, tmp_path):
    (tmp_path / "mask.yaml").write_text("mask: {kind: sphere, centre: [0, 0, 0], radius: 0.3}\n")
    arguments = ("run", str(capture), *INGEST, "--mask", str(tmp_path / "mask.yaml"))
    assert cli(*arguments).returncode == 0
    folders = [cli.store, *(p for p in cli.store.rglob("*") if p.is_dir())]
    rights = {folder: stat.S_IMODE(folder.stat().st_mode) for folder in folders}
    for folder in folders:
        folder.chmod(0o555)
    try:
        cached = cli(*arguments, preexec_fn=obey_rights)
        dry = cli("gc", "--dry-run", preexec_fn=obey_rights)
        verified = cli("verify", preexec_fn=obey_rights)
        wet = cli("run", str(capture), *INGEST, "--seed", "7", preexec_fn=obey_rights)
    finally:
        for folder, mode in rights.items():
            folder.chmod(mode)
    assert cached.returncode == 0, cached.stderr
    assert "nothing to be done" in cached.stderr
    assert cached.stderr.count("it will not remember this run") == 1
    assert dry.returncode == 0, dry.stderr
    assert verified.returncode == 0, verified.stderr
    assert wet.returncode == 5, wet.stderr
    assert "no access to" in wet.stderr
    assert len(list((cli.store / "runs" / "tiny").iterdir())) == 1


def test_a_file_given_as_the_store_is_a_configuration_error(cli, capture, tmp_path):
    cli.store = tmp_path / "notes.txt"
    cli.store.touch()
    for arguments in (("run", str(capture), *INGEST), ("gc",), ("runs",), ("verify",)):
        result = cli(*arguments)
        assert result.returncode == 2, result.stderr
        assert f"{cli.store} is a file where a store has a folder" in result.stderr


def test_control_characters_in_names_do_not_reach_the_terminal(cli, tmp_path):
    capture = tmp_path / "a\x1b]0;owned\x07[red]b"
    capture.mkdir()
    (capture / "note.txt").write_text("stubs do not look")
    commands = (
        ("run", str(capture), *INGEST), ("runs",), ("why", capture.name, "capture-ingest"), ("show", capture.name),
        ("lineage", capture.name), ("run", str(capture / "no\x1bwhere")),
    )  # fmt: skip
    told = [cli(*command) for command in commands]
    assert [r.returncode for r in told] == [0, 0, 0, 0, 2, 3], [r.stderr for r in told]
    assert not any(c in r.stdout + r.stderr for r in told for c in "\x1b\x07")
    assert "a\\x1b]0;owned\\x07[" in told[1].stdout
