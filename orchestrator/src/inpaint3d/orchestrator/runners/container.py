"""A stage in a container of its own: no network, read-only root, not root, its memory limited.

This module's process stands in the stage's place for the scheduler. It holds the lock of the key, starts the image on a
scratch store that has nothing but the stage's inputs, and takes what the stage committed there into the real one, file
by file against its digests. The real store is never in a container's reach (docs/adr/0006). The scratch lies with the
key's checkpoints, so that a run that was killed goes on from them.
"""

import argparse
import csv
import io
import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inpaint3d.contracts.errors import ConfigurationError, Inpaint3dError, RetryableError, from_os_error
from inpaint3d.contracts.kit.code import IMAGE_DIGEST
from inpaint3d.contracts.kit.confine import die_with_parent
from inpaint3d.contracts.kit.invocation import Invocation, load_invocation
from inpaint3d.contracts.kit.process import GRACE_S
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.cluster import Image
from inpaint3d.contracts.models.stage import StageSpec, memory_bytes
from inpaint3d.contracts.store import FolderStore, Store, hex_of, open_store
from inpaint3d.contracts.store.workspace import remove

ENGINES = ("podman", "docker")
STAGE_USER = 10001
"""Who a stage is where whoever runs it is root: nobody, as in the images and in a pod."""
SCRATCH, INVOCATION = "/store", "invocation.json"
ENGINE_FAILED = (125, 126, 127)
"""Exit codes that are the engine's own: it could not start the container."""
OPEN_FOLDER, OPEN_FILE = 0o555, 0o444


@dataclass(frozen=True)
class ContainerRunner:
    """Stages in the images built for them, by an engine with podman's or docker's command line."""

    engine: str
    images: Mapping[str, Image]

    def command(self, spec: StageSpec, store: Store, key: Digest, request: Path) -> list[str]:
        """The module that starts the image: this one."""
        image = self.images[spec.spec.image]
        memory = spec.spec.resources.limits.get("memory")
        return [
            __spec__.name, "--engine", self.engine, "--image", image.image, "--digest", image.digest,
            "--store", store.place, "--key", key, "--invocation", str(request),
            *(["--memory", str(memory_bytes(memory))] if memory else []),
        ]  # fmt: skip

    def environment(self) -> dict[str, str]:
        """All of it: the engine has its own variables, and passes none of them on."""
        return dict(os.environ)


def find_engine(given: str | None) -> str:
    """The engine asked for, or the first of podman and docker on the PATH. ConfigurationError where there is none."""
    for name in (given,) if given else ENGINES:
        if found := shutil.which(name):
            return found
    raise ConfigurationError(
        f"there is no {given or ' and no '.join(ENGINES)} on the PATH; install one, or --runner process"
    )


@dataclass(frozen=True)
class Container:
    """One stage's container, as it is asked for."""

    engine: str
    image: str
    digest: Digest
    name: str
    memory: int | None
    scratch: Path
    inputs: Mapping[Digest, Path]
    cuda: bool

    def command(self) -> list[str]:
        """The engine's command line. Podman and docker both know every option of it."""
        options = [
            "run", "--rm", "--name", self.name, "--pull", "never", "--log-driver", "none",
            "--network", "none", "--read-only", "--tmpfs", "/tmp",  # noqa: S108 - in the container
            "--cap-drop", "ALL", "--security-opt", "no-new-privileges", "--security-opt", "label=disable",
            *_choose_user(self.engine),
            "--env", f"{IMAGE_DIGEST}={self.digest}", "--env", "PYTHONUNBUFFERED=1",
            "--mount", _bind(self.scratch, SCRATCH),
        ]  # fmt: skip
        for digest, folder in self.inputs.items():
            options += ["--mount", _bind(folder, f"{SCRATCH}/objects/{hex_of(digest)}", "readonly")]
        if self.memory is not None:  # swap is counted in it: a stage that needs more is to end, not to crawl
            options += ["--memory", f"{self.memory}b", "--memory-swap", f"{self.memory}b"]
        if self.cuda:
            options += ["--device", "nvidia.com/gpu=all"]
        return [self.engine, *options, self.image, "run", "--store", SCRATCH, "--invocation", f"{SCRATCH}/{INVOCATION}"]

    def run(self) -> int:
        """Run it to its end; SIGTERM and SIGINT are passed on. Returns its exit code."""
        asked: list[float] = []

        def stop(_number: int, _frame: object) -> None:
            asked.append(time.monotonic())

        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, stop)
        self._call_engine("rm", "--force", self.name)  # of a run whose own supervisor was killed
        process = subprocess.Popen(self.command(), stdin=subprocess.DEVNULL)
        while True:
            try:
                return process.wait(timeout=1.0)
            except subprocess.TimeoutExpired:
                # Again and again: the first process of a container is deaf until it has its handler.
                if asked:
                    process.terminate()
                if asked and time.monotonic() - asked[0] > 2 * GRACE_S:
                    self._call_engine("kill", self.name)

    def _call_engine(self, *line: str) -> None:
        subprocess.run([self.engine, *line], capture_output=True, check=False)


def _bind(source: Path, target: str, *flags: str) -> str:
    """A value of `--mount`, which engines read as a line of CSV: a path may hold a comma or a quote."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(["type=bind", f"source={source}", f"target={target}", *flags])
    return line.getvalue()


def _choose_user(engine: str) -> list[str]:
    """Files are written as whoever runs this; root's containers are nobody's, whom the scratch then belongs to."""
    if os.getuid() == 0:
        return ["--user", f"{STAGE_USER}:{STAGE_USER}"]
    mapped = ["--userns", "keep-id"] if Path(engine).name == "podman" else []
    return [*mapped, "--user", f"{os.getuid()}:{os.getgid()}"]


def contained(store: Store, key: Digest, invocation: Invocation, container: argparse.Namespace) -> int:
    """Run a stage in its container and take over its result; the exit code. Errors are the tree of `errors`."""
    with store.shared(), store.lock(key):
        if store.lookup(key) is not None:
            return 0
        place = store.work_folder(key) / "store"
        if not place.is_dir():  # a run that was killed left nothing else there
            remove(place)
        scratch = FolderStore(place)
        code = Container(
            engine=container.engine,
            image=container.image,
            digest=container.digest,
            name=f"inpaint3d-{hex_of(digest_of([store.place, key]))[:16]}",
            memory=container.memory,
            scratch=scratch.root.resolve(),
            inputs=_fill_scratch(scratch, store, invocation),
            cuda=invocation.device == "cuda",
        ).run()
        if code in ENGINE_FAILED:
            raise ConfigurationError(
                f"{container.engine} could not start {container.image} (exit {code}); `make images` builds it"
            )
        if code == 0:
            take_over(scratch, store, key)
            store.drop_work(key)
    return code


def _fill_scratch(scratch: Store, store: Store, invocation: Invocation) -> dict[Digest, Path]:
    """Leave the invocation in the scratch; the folders of the inputs, which are mounted where the shim looks."""
    given = [d for ds in invocation.inputs.values() for d in ([ds] if isinstance(ds, str) else ds)]
    inputs = {digest: store.fetch(digest) for digest in given}
    for digest, folder in inputs.items():
        _open_to_all(folder)
        scratch.object_path(digest).mkdir(exist_ok=True)
    # Its parent is another in there.
    request = invocation.model_copy(update={"die_with_parent": False})
    (scratch.root / INVOCATION).write_text(request.model_dump_json())
    if os.getuid() == 0:
        for path in (scratch.root, *scratch.root.rglob("*")):
            os.chown(path, STAGE_USER, STAGE_USER, follow_symlinks=False)
    return inputs


def _open_to_all(folder: Path) -> None:
    """Let a container's user, who is nobody here, read an artifact, where the umask did not."""
    for path in (folder, *folder.rglob("*")):
        mode = stat.S_IMODE(path.stat().st_mode)
        if (wanted := mode | (OPEN_FOLDER if path.is_dir() else OPEN_FILE)) != mode:
            path.chmod(wanted)


def take_over(scratch: Store, store: Store, key: Digest) -> None:
    """Copy a committed result from one store into another, checked against its digests, and commit it there."""
    if (record := scratch.lookup(key)) is None:
        raise RetryableError(
            f"the container committed nothing under {key}: its image was built from other code; run again"
        )
    for digest in record.outputs.values():
        store.adopt(scratch.object_path(digest), scratch.manifest(digest))
    store.commit(record)


def main() -> None:
    """Entry point of the scheduler's child; says errors as the shim does."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("engine", "image", "digest", "store", "key"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--invocation", type=Path, required=True)
    parser.add_argument("--memory", type=int)
    given = parser.parse_args()
    try:
        invocation = load_invocation(given.invocation)
        if invocation.die_with_parent:
            die_with_parent()
        sys.exit(contained(open_store(given.store), given.key, invocation, given))
    except Inpaint3dError as error:
        _say(error)
    except OSError as error:
        _say(from_os_error(error))


def _say(error: Inpaint3dError) -> None:
    event: dict[str, Any] = {"event": "error", "kind": error.kind, "message": str(error), "exit_code": error.exit_code}
    sys.stdout.write(json.dumps(event) + "\n")
    sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
