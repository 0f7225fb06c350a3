import multiprocessing
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from inpaint3d.contracts.errors import ConfigurationError, RetryableError
from inpaint3d.orchestrator.run_folder import LOCK, own_folder


def _hold(folder: str, ready) -> None:
    with own_folder(Path(folder)):
        ready.set()
        time.sleep(60)


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the folder."""
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    process = context.Process(target=_hold, args=(str(tmp_path / "kitchen"), ready))
    process.start()
    assert ready.wait(60)
    yield process
    process.kill()
    process.join()


def test_a_second_run_is_told_who_holds_the_folder(tmp_path, holder):
    with (
        pytest.raises(
            RetryableError, match=rf"kitchen is held .*process {holder.pid} on .*, since .*--name, or --wait"
        ),
        own_folder(tmp_path / "kitchen"),
    ):
        pytest.fail("two runs in one folder")
    with own_folder(tmp_path / "hall"):
        pass


def test_the_lock_dies_with_its_holder_and_may_be_waited_for(tmp_path, holder, capsys):
    threading.Timer(0.5, os.kill, (holder.pid, signal.SIGKILL)).start()
    with own_folder(tmp_path / "kitchen", wait=True):
        pass
    assert f"waiting for the run that holds it (process {holder.pid}" in capsys.readouterr().err
    with own_folder(tmp_path / "kitchen"):
        pass


@pytest.mark.parametrize("harm", ["link", "folder", "junk"])
def test_what_lies_in_the_place_of_the_lock_does_no_harm(tmp_path, harm):
    lock = tmp_path / LOCK
    if harm == "link":
        lock.symlink_to("/nowhere/at/all")
    elif harm == "folder":
        lock.mkdir()
    else:
        lock.write_bytes(b"\xff[")
    with own_folder(tmp_path), pytest.raises(RetryableError, match="is held"), own_folder(tmp_path):
        pytest.fail("two runs in one folder")


def test_a_file_in_the_place_of_the_folder_is_a_configuration_error(tmp_path):
    (tmp_path / "kitchen").touch()
    with pytest.raises(ConfigurationError, match="kitchen is no folder"), own_folder(tmp_path / "kitchen"):
        pytest.fail("no folder to own")
