"""The local folder that every store works in, its own or a bucket's cache: private folders, checkpoints, locks."""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Generator
from pathlib import Path

from inpaint3d.contracts.errors import RetryableError, from_os_error
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import canonical_json
from inpaint3d.contracts.models.manifest import MANIFEST, Manifest
from inpaint3d.contracts.store.artifact import find_folder_damage, hex_of


class Workspace:
    """A folder that many processes may share; its locks are flock and die with their holder."""

    def __init__(self, root: Path, place: str) -> None:
        self.root, self.place = root, place
        try:
            for name in ("objects", "work", "tmp", "locks", "quarantine"):
                (root / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise from_os_error(error) from error

    def object_path(self, digest: Digest) -> Path:
        """Where an artifact lies on this machine, if it does."""
        return self.root / "objects" / hex_of(digest)

    def private_folder(self) -> Path:
        """An empty folder on the store's file system, for writing an artifact in."""
        return Path(tempfile.mkdtemp(dir=self.root / "tmp", prefix=f"{os.getpid()}-"))

    def keep(self, folder: Path, manifest: Manifest) -> Digest:
        """Make a filled private folder the artifact of its manifest, read-only from now on: whole or not at all."""
        (folder / MANIFEST).write_bytes(canonical_json(manifest.dump()))
        for path in folder.rglob("*"):
            if path.is_file():
                fsync(path)
                path.chmod(0o444)
        target = self.object_path(manifest.digest)
        try:
            folder.rename(target)
        except OSError:
            if not target.is_dir():
                raise
            if find_folder_damage(target, manifest.digest) is None:  # somebody was first with the same bytes
                shutil.rmtree(folder)
            else:
                self.discard(target)
                folder.rename(target)
        fsync(target.parent)
        return manifest.digest

    def discard(self, path: Path) -> None:
        """Take a file or folder out of sight, keeping its bytes for a look."""
        path.rename(Path(tempfile.mkdtemp(dir=self.root / "quarantine")) / path.name)

    def work_folder(self, key: Digest) -> Path:
        """Where a run keeps its checkpoints until it commits; the same folder after a kill."""
        path = self.root / "work" / hex_of(key)
        path.mkdir(exist_ok=True)
        return path

    def drop_work(self, key: Digest) -> None:
        """Remove the checkpoints of a run that has committed."""
        shutil.rmtree(self.root / "work" / hex_of(key), ignore_errors=True)

    @contextlib.contextmanager
    def lock(self, name: str) -> Generator[None]:
        """Hold the lock of one key or digest; waits for whoever has it."""
        path = self.root / "locks" / hex_of(name)
        with path.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    @contextlib.contextmanager
    def shared(self) -> Generator[None]:
        """Keep `exclusive` away. Whoever writes or reads results holds it; any number may at a time."""
        with (self.root / "locks" / "in-use").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_SH)
            yield

    @contextlib.contextmanager
    def exclusive(self) -> Generator[None]:
        """Keep everybody else away, to remove things; RetryableError where the store is in use on this machine."""
        with (self.root / "locks" / "in-use").open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise RetryableError(f"a run is using {self.place}; try again when it has ended") from error
            yield

    def sweep_tmp(self) -> None:
        """Remove what processes that are gone left in tmp/."""
        for path in (self.root / "tmp").iterdir():
            owner = path.name.split("-")[0]
            if owner.isdigit() and not Path(f"/proc/{owner}").exists():
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)


def fsync(path: Path) -> None:
    """Wait until a file, or a folder's list of names, is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
