"""The local folder that every store works in, its own or a bucket's cache: private folders, checkpoints, locks."""

import contextlib
import errno
import fcntl
import os
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Generator
from pathlib import Path

from inpaint3d.contracts.errors import ConfigurationError, RetryableError, from_os_error
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import canonical_json
from inpaint3d.contracts.models.manifest import MANIFEST, Manifest
from inpaint3d.contracts.store.artifact import find_folder_damage, hex_of
from inpaint3d.contracts.store.owner import Owner, parse_owner, this_process

FOLDERS = ("objects", "work", "tmp", "locks", "quarantine")
OWNER = ".owner"
LEASE_S = 7 * 24 * 3600.0
"""What a process of another machine has left untouched for this long is nobody's: a stage writes every few seconds."""
_NO_FILE = (errno.ELOOP, errno.EISDIR, errno.ENXIO)
_NO_WRITING = (errno.EROFS, errno.EACCES, errno.EPERM)


class Workspace:
    """A folder that many processes may share; its locks are flock and die with their holder."""

    def __init__(self, root: Path, place: str) -> None:
        self.root, self.place = root, place
        if root.is_dir() and not os.access(root, os.W_OK):
            return  # to be read only
        for path in (root / name for name in FOLDERS):
            try:
                path.mkdir(parents=True, exist_ok=True)
            except (FileExistsError, NotADirectoryError) as error:
                in_the_way = next((p for p in (*reversed(path.parents), path) if p.is_file()), path)
                raise ConfigurationError(
                    f"--store {place}: {in_the_way} is a file where a store has a folder; "
                    "give another folder, or move the file away"
                ) from error
            except OSError as error:
                raise from_os_error(error) from error

    def object_path(self, digest: Digest) -> Path:
        """Where an artifact lies on this machine, if it does."""
        return self.root / "objects" / hex_of(digest)

    def private_folder(self) -> Path:
        """An empty folder on the store's file system, for writing an artifact in."""
        path = self.private_path()
        path.mkdir()  # with the rights of the umask, which the artifact will have
        return path

    def private_path(self) -> Path:
        """A path in tmp/ that nobody else has, whose name says whose it is."""
        return self.root / "tmp" / f"{this_process()}-{secrets.token_hex(8)}"

    def keep(self, folder: Path, manifest: Manifest) -> Digest:
        """Make a filled private folder the artifact of its manifest, read-only from now on: whole or not at all."""
        (folder / MANIFEST).write_bytes(canonical_json(manifest.dump()))
        for path in folder.rglob("*"):
            if path.is_file():
                fsync(path)
                path.chmod(stat.S_IMODE(path.stat().st_mode) & 0o555)
        target = self.object_path(manifest.digest)
        try:
            folder.rename(target)
        except OSError:
            if not os.path.lexists(target):
                raise
            if find_folder_damage(target, manifest.digest) is None:  # somebody was first with the same bytes
                shutil.rmtree(folder)
            else:
                self.discard(target)
                folder.rename(target)
        fsync(target.parent)
        return manifest.digest

    def discard(self, path: Path) -> None:
        """Take a file or folder out of sight, keeping its bytes for a look; nothing where somebody else just did."""
        target = self.root / "quarantine" / secrets.token_hex(8)
        target.mkdir(parents=True)
        try:
            path.rename(target / path.name)
        except FileNotFoundError:
            target.rmdir()

    def work_folder(self, key: Digest) -> Path:
        """Where a run keeps its checkpoints until it commits; the same folder after a kill."""
        path = self._name_work_path(key)
        if os.path.lexists(path) and not path.is_dir():
            note(f"{path} is no folder; it was moved to quarantine")
            self.discard(path)
        path.mkdir(exist_ok=True)
        path.with_suffix(OWNER).write_text(str(this_process()))
        return path

    def drop_work(self, key: Digest) -> None:
        """Remove the checkpoints of a run that has committed."""
        remove(self._name_work_path(key))
        self._name_work_path(key).with_suffix(OWNER).unlink(missing_ok=True)

    def abandon_work(self, key: Digest) -> None:
        """Take the checkpoints of a run out of sight: it cannot go on from them."""
        self.discard(self._name_work_path(key))

    def list_litter(self) -> list[Path]:
        """What no result needs: quarantine, and checkpoints but those that another machine may be at work on."""
        found = [*_list(self.root / "quarantine")]
        for path in _list(self.root / "work"):
            owner = _read_owner(path.with_suffix(OWNER))
            if owner is None or owner.host == this_process().host or _is_abandoned(owner, path):
                found.append(path)
        return found

    def _name_work_path(self, key: Digest) -> Path:
        return self.root / "work" / hex_of(key)

    @contextlib.contextmanager
    def lock(self, name: str) -> Generator[None]:
        """Hold the lock of one key or digest; waits for whoever has it."""
        with self._hold(hex_of(name), fcntl.LOCK_EX):
            yield

    @contextlib.contextmanager
    def shared(self) -> Generator[None]:
        """Keep `exclusive` away. Whoever writes or reads results holds it; any number may at a time."""
        with self._hold("in-use", fcntl.LOCK_SH):
            yield

    @contextlib.contextmanager
    def exclusive(self) -> Generator[None]:
        """Keep everybody else away, to remove things; RetryableError where the store is in use on this machine."""
        with contextlib.ExitStack() as held:
            try:
                held.enter_context(self._hold("in-use", fcntl.LOCK_EX | fcntl.LOCK_NB))
            except BlockingIOError as error:
                raise RetryableError(f"a run is using {self.place}; try again when it has ended") from error
            yield

    @contextlib.contextmanager
    def _hold(self, name: str, how: int) -> Generator[None]:
        descriptor = self._open_lock(self.root / "locks" / name)
        try:
            if descriptor is not None:
                fcntl.flock(descriptor, how)
            yield
        finally:
            if descriptor is not None:
                os.close(descriptor)

    def _open_lock(self, path: Path) -> int | None:
        """A lock's file, made where there is none; None where the store is to be read only and has none."""
        try:
            return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            if error.errno in _NO_FILE:
                note(f"{path} is no lock; it was moved to quarantine")
                self.discard(path)
                return self._open_lock(path)
            if error.errno not in _NO_WRITING and os.access(self.root, os.W_OK):
                raise
            refusal = error
        try:
            return os.open(path, os.O_RDONLY)
        except OSError:
            if os.access(self.root, os.W_OK):
                raise refusal from None  # it says why there is none: the folder of locks alone cannot be written
            return None

    def sweep_tmp(self) -> None:
        """Remove what processes that are gone left in tmp/."""
        for path in _list(self.root / "tmp"):
            owner = parse_owner(path.name.partition("-")[0])
            if owner is not None and _is_abandoned(owner, path):
                remove(path)


def note(message: str) -> None:
    """Say on standard error what was found amiss and has been mended."""
    sys.stderr.write(f"inpaint3d: {message}\n")


def remove(path: Path) -> None:
    """Remove a file, a link, or a folder with all in it; what is not there needs no removing."""
    if path.is_dir() and not path.is_symlink():
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


def _list(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _is_abandoned(owner: Owner, path: Path) -> bool:
    """Whether nobody is at work on a file or folder: its owner is dead, or, where that cannot be told, long silent."""
    if owner.is_gone:
        return True
    if owner.host == this_process().host:
        return False
    newest = max((p.lstat().st_mtime for p in (path, *path.rglob("*"))), default=0.0)
    return time.time() - newest > LEASE_S


def _read_owner(path: Path) -> Owner | None:
    try:
        return parse_owner(path.read_text())
    except (OSError, UnicodeDecodeError):
        return None
