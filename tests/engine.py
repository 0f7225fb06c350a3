"""What an engine of containers would do, as a process: bind mounts become paths of this machine.

Run as `engine run OPTIONS IMAGE ARGUMENTS`. It refuses options that it does not know, writes down what it was asked,
and misbehaves as `ENGINE_FAULT` says: `deaf` (the first SIGTERM is lost, as by the first process of a container that
has no handler yet), or a number, which it exits with.
"""

import argparse
import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any


def main() -> None:
    with Path(os.environ["ENGINE_LOG"]).open("a") as log:
        log.write(json.dumps(sys.argv[1:]) + "\n")
    if sys.argv[1] != "run":
        return
    given, command = parsed(sys.argv[2:])
    fault = os.environ.get("ENGINE_FAULT", "")
    if not given.image.startswith("images.example/"):
        sys.exit(125)
    if fault.isdigit():
        sys.exit(int(fault))
    if fault == "deaf":
        deaf()
    places = [dict(part.partition("=")[::2] for part in row) for row in csv.reader(given.mount)]
    root = next(p["source"] for p in places if "readonly" not in p)
    for place in places:
        if "readonly" in place:
            target = Path(place["target"].replace("/store", root, 1))
            # A run that was killed left its link: there is nobody to unmount it.
            target.unlink() if target.is_symlink() else target.rmdir()
            target.symlink_to(place["source"])
    name = given.image.split("/")[-1].split(":")[0].replace("-", "_")
    line = [sys.executable, "-m", f"inpaint3d.stages.{name}", *(a.replace("/store", root, 1) for a in command)]
    environment = {**os.environ, **dict(e.split("=", 1) for e in given.env)}
    stage = subprocess.Popen(line, env=environment)
    signal.signal(signal.SIGTERM, lambda *_: stage.terminate())
    code = stage.wait()
    sys.exit(code if code >= 0 else 128 - code)


def parsed(line: list[str]) -> tuple[Any, list[str]]:
    """Options and image; the command."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rm", action="store_true")
    parser.add_argument("--read-only", action="store_true")
    for name in ("name", "pull", "log-driver", "network", "cap-drop", "user", "userns", "memory", "memory-swap"):
        parser.add_argument(f"--{name}")
    for name in ("tmpfs", "security-opt", "env", "mount"):
        parser.add_argument(f"--{name}", action="append")
    parser.add_argument("image")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    given = parser.parse_args(line)
    return given, given.command


def deaf() -> None:
    """Wait for two SIGTERMs, then leave as a stage does that was stopped."""
    heard: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: heard.append(number))
    Path(os.environ["ENGINE_LOG"]).with_suffix(".deaf").touch()
    while len(heard) < 2:
        time.sleep(0.05)
    sys.exit(143)


if __name__ == "__main__":
    main()
