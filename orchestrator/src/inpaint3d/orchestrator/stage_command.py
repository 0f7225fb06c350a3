"""A second command of a stage, for a person: it runs in the stage's own process, on artifacts of a run."""

import importlib.util
import os
import subprocess
import sys
from collections.abc import Mapping

from inpaint3d.contracts.errors import ConfigurationError, InterruptedRun
from inpaint3d.contracts.kit.confine import select_environment
from inpaint3d.contracts.kit.process import thread_environment
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.store import Store

THREADS = 1
END_S = 5.0


def run_stage_command(
    module: str, command: str, store: Store, artifacts: Mapping[str, Digest | None], options: list[str]
) -> int:
    """Run it until it ends, or Ctrl-C ends it; its exit code. artifacts: option -> digest, where there is one."""
    line = build_line(module, command, store.place, artifacts, options)
    process = subprocess.Popen(line, env=select_environment(os.environ) | thread_environment(THREADS))
    try:
        return process.wait()
    except KeyboardInterrupt:  # the terminal has told it too
        try:
            return process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            return InterruptedRun.exit_code


def build_line(
    module: str, command: str, store: str, artifacts: Mapping[str, Digest | None], options: list[str]
) -> list[str]:
    """The command in this environment; store: its place."""
    line = [sys.executable, "-m", module, command, "--store", store, "--die-with-parent", *options]
    return line + [part for option, digest in artifacts.items() if digest for part in (f"--{option}", digest)]


def check_installed(module: str) -> None:
    """ConfigurationError where the stage is in images alone: a container has no network for a page."""
    if importlib.util.find_spec(module) is None:
        raise ConfigurationError(
            f"the page is served by {module}, which is not installed in this environment ({sys.prefix}): containers "
            "have no network to serve it from; run `make install`, or `uv sync --all-packages`, here"
        )
