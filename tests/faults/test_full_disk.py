"""A disk without room: the storage exit code, a message that names the file and the repair, nothing committed."""

import json
import resource
import subprocess
import sys

from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.kit.upstream import build_command, store_externals
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore
from tests.conftest import REPOSITORY


def test_no_room_for_an_artifact(tmp_path):
    """A limit on the size of files is the full disk that a test can have without being root."""
    spec = Pipeline(REPOSITORY / "pipeline.yaml").stages["capture-ingest"]
    store = FolderStore(tmp_path / "store")
    source = store_externals(store)["external.capture"]
    line = build_command(spec, store, Invocation(inputs={"source": source}, stub=True))
    limit = 1024
    result = subprocess.run(
        line, capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )  # fmt: skip
    event = json.loads(result.stdout.splitlines()[-1])
    assert result.returncode == 5, result.stdout + result.stderr
    assert "no space left" in event["message"]
    assert list(store.records()) == []


def test_no_room_for_the_capture_itself(cli, capture):
    """The orchestrator takes it in; the message names the copy that did not fit, in the store."""
    (capture / "photo.jpg").write_bytes(bytes(1 << 20))
    limit = 100_000
    result = cli(
        "run", str(capture), "--stub", preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit,) * 2)
    )
    assert result.returncode == 5, result.stderr
    assert f"no space left writing {cli.store}" in result.stderr
    store = FolderStore(cli.store)
    assert list(store.records()) == []
    assert list((store.root / "objects").iterdir()) == []
    assert cli("gc").returncode == 0
    assert list((store.root / "tmp").iterdir()) == []


LOCK_A_KEY = """
import sys
from pathlib import Path
from inpaint3d.contracts.errors import from_os_error
from inpaint3d.contracts.store import FolderStore
from tests.faults.write_sites import fail_at
store = FolderStore(Path(sys.argv[1]))
fail_at(1, "EROFS")
try:
    with store.lock("sha256:" + 64 * "0"):
        pass
except OSError as error:
    print(from_os_error(error).exit_code)
"""


def test_a_lock_that_cannot_be_made_is_not_reported_as_one_that_is_missing(tmp_path):
    """The folder of locks alone is read-only: nothing else says why there is no lock."""
    line = [sys.executable, "-W", "ignore", "-c", LOCK_A_KEY, str(tmp_path / "store")]
    told = subprocess.run(line, cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert told.stdout == "5\n"
