"""What a killed run goes on from: COLMAP's files as they were sealed, never as they lie there.

COLMAP's databases and models have no sums of their own: of a flipped bit nobody would know. A snapshot is a checkpoint
whose tensors are the files' bytes, hashed, on the disk before it is seen, in two generations.
"""

import contextlib
import time
from collections.abc import Callable, Generator
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save_file

from inpaint3d.contracts.errors import InterruptedRun
from inpaint3d.contracts.kit.checkpoints import OPEN_SEAL, find_checkpoint, write_checkpoint
from inpaint3d.contracts.store.workspace import remove

# A database of some hundred megabytes takes a second or two.
KEEP_EVERY_S = 30.0


def save_snapshot(path: Path) -> None:
    """Keep a file, or all files of a folder, as they are now."""
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    contents = {str(p.relative_to(path.parent)): np.fromfile(p, np.uint8) for p in files}
    write_checkpoint(_snapshot_of(path), lambda staged: save_file(contents, staged, metadata=OPEN_SEAL))


def restore_snapshot(path: Path) -> bool:
    """Make a file or folder what its newest whole snapshot holds, whatever lies there; without one, nothing."""
    for left in (path, *path.parent.glob(f"{path.name}-*")):  # of a database that was open, its log
        remove(left)
    if (found := find_checkpoint(_snapshot_of(path))) is None:
        return False
    for name, content in load_file(found).items():
        file = path.parent / name
        file.parent.mkdir(parents=True, exist_ok=True)
        content.tofile(file)
    return True


@contextlib.contextmanager
def keep_snapshots(path: Path) -> Generator[Callable[[], None]]:
    """Keep what is worked on: now and then, whenever the function given is called, when interrupted, at the end."""
    kept = time.monotonic()

    def keep_when_due() -> None:
        nonlocal kept
        if time.monotonic() - kept > KEEP_EVERY_S:
            save_snapshot(path)
            kept = time.monotonic()

    try:
        yield keep_when_due
    except InterruptedRun:
        save_snapshot(path)
        raise
    save_snapshot(path)


def _snapshot_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.safetensors")
