"""The pipeline as a user runs it: `inpaint3d` as a process, on a store of the test's own."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.s3 import bucket, network

__all__ = ["bucket", "network"]

REPOSITORY = Path(__file__).parents[1]


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "kubernetes: needs a cluster; `make test-kubernetes`")


class Cli:
    """`inpaint3d` in a folder of its own."""

    def __init__(self, folder: Path, extra: dict[str, str] | None = None) -> None:
        self.folder = folder
        self.extra = extra or {}
        self.store: Path | str = folder / "store"
        self.runs = folder / "runs"

    def command(self, *arguments: str) -> list[str]:
        return [str(Path(sys.executable).parent / "inpaint3d"), *arguments]

    def environment(self) -> dict[str, str]:
        places = {"STORE": self.store, "RUNS": self.runs, "CACHE": self.folder / "cache"}
        return {**os.environ, **{f"INPAINT3D_{name}": str(place) for name, place in places.items()}, **self.extra}

    def __call__(self, *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.command(*arguments),
            capture_output=True, text=True, check=False, env=self.environment(), cwd=REPOSITORY, **options,
        )  # fmt: skip

    def start(self, *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            self.command(*arguments),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=self.environment(), cwd=REPOSITORY,
        )  # fmt: skip

    def statuses(self, name: str = "tiny") -> dict[str, str]:
        """Stage -> state of the last run of a name."""
        report = json.loads(self("show", name, "--json").stdout)
        return {s["node"]: s["status"] for s in report["stages"]}


@pytest.fixture
def cli(tmp_path: Path) -> Cli:
    return Cli(tmp_path)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A folder that stubs do not look into."""
    folder = tmp_path / "tiny"
    folder.mkdir()
    (folder / "note.txt").write_text("stubs do not look")
    return folder
