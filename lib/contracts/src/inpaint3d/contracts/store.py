"""The content-addressed store: artifacts by digest, results by key, visible whole or not at all.

    objects/DIGEST/         an artifact: artifact.json and its files, read-only once there
    keys/KEY.json           the commit point: key -> output digests, components, provenance, times. Immutable
    work/KEY/               checkpoints of a run that has not committed yet
    tmp/  locks/  quarantine/

Commit: write in a private folder below tmp/ -> validate -> hash -> fsync -> rename into objects/ -> fsync the folder ->
link keys/KEY.json, last. A kill at any point leaves either nothing visible or everything.
"""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import ValidationError

from inpaint3d.contracts.canonical import canonical_json, file_digest
from inpaint3d.contracts.errors import ArtifactError, from_os_error
from inpaint3d.contracts.manifest import (
    MANIFEST,
    Manifest,
    build_manifest,
    describe_files,
    first_error,
    read_metadata,
)
from inpaint3d.contracts.model import Closed, Digest

M = TypeVar("M", bound=Closed)


@dataclass(frozen=True)
class Artifact(Generic[M]):
    """A stored artifact, opened for reading."""

    root: Path
    digest: Digest
    manifest: Manifest
    metadata: M

    def path(self, relative: str) -> Path:
        """The file that the artifact holds under this path; ArtifactError where it holds none."""
        path = self.root / relative
        if not path.is_file():
            raise ArtifactError(f"{self.manifest.schema_id} has no file {relative} ({self.root})")
        return path


class Record(Closed):
    """`keys/KEY.json`: what a key produced, and how. Only `outputs` matters to those who reuse it."""

    key: Digest
    stage: str
    components: dict[str, Any]
    outputs: dict[str, Digest]
    provenance: dict[str, Any]
    timings: dict[str, Any]


class Store:
    """A store in a local folder. Safe for many processes; locks are flock and die with their holder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        try:
            for name in ("objects", "keys", "work", "tmp", "locks", "quarantine"):
                (root / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise from_os_error(error) from error

    def object_path(self, digest: Digest) -> Path:
        return self.root / "objects" / digest.removeprefix("sha256:")

    def private_folder(self) -> Path:
        """An empty folder on the store's file system, for writing an artifact in."""
        return Path(tempfile.mkdtemp(dir=self.root / "tmp", prefix=f"{os.getpid()}-"))

    def put(self, folder: Path, name: str, metadata: Closed) -> Digest:
        """Move a filled private folder into the store as an artifact of schema `name`; returns its digest."""
        return self._place(folder, build_manifest(folder, name, metadata))

    def adopt(self, source: Path, manifest: Manifest) -> Digest:
        """Copy in an artifact that lies elsewhere; ArtifactError where its files are not what its manifest says."""
        folder = self.private_folder()
        for entry in manifest.files:
            target = folder / entry.path
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / entry.path, target)
        if describe_files(folder) != manifest.files:
            shutil.rmtree(folder)
            raise ArtifactError(f"{source} is damaged: its files are not those of its {MANIFEST}; get it again")
        return self._place(folder, manifest)

    def _place(self, folder: Path, manifest: Manifest) -> Digest:
        (folder / MANIFEST).write_bytes(canonical_json(manifest.dumped()))
        for path in folder.rglob("*"):
            if path.is_file():
                _fsync(path)
                path.chmod(0o444)
        target = self.object_path(manifest.digest)
        try:
            folder.rename(target)
        except OSError:
            if not target.is_dir():
                raise
            if self.damage(manifest.digest) is None:  # somebody was first with the same bytes
                shutil.rmtree(folder)
            else:
                self.quarantine(manifest.digest)
                folder.rename(target)
        _fsync(target.parent)
        return manifest.digest

    def manifest(self, digest: Digest) -> Manifest:
        path = self.object_path(digest) / MANIFEST
        try:
            return Manifest.model_validate_json(path.read_bytes())
        except FileNotFoundError as error:
            raise ArtifactError(f"artifact {digest} is not in the store {self.root}; run the pipeline again") from error
        except ValidationError as error:
            raise ArtifactError(f"{path} is not a manifest ({first_error(error)}); run the pipeline again") from error

    def open(self, digest: Digest, model: type[M]) -> Artifact[M]:
        """Open a verified artifact. A damaged one is quarantined and reported, never read."""
        if (damage := self.damage(digest)) is not None:
            self.quarantine(digest)
            raise ArtifactError(f"{damage}; it was moved to quarantine, run the pipeline again to recompute it")
        manifest = self.manifest(digest)
        return Artifact(self.object_path(digest), digest, manifest, read_metadata(manifest, model))

    def damage(self, digest: Digest) -> str | None:
        """What is wrong with a stored artifact (bytes against its digest), or None."""
        root = self.object_path(digest)
        try:
            manifest = self.manifest(digest)
        except ArtifactError as error:
            return str(error)
        if manifest.digest != digest:
            return f"{root / MANIFEST} does not hash to {digest}"
        for entry in manifest.files:
            path = root / entry.path
            if not path.is_file():
                return f"{path} is missing"
            if path.stat().st_size != entry.size or file_digest(path) != f"sha256:{entry.sha256}":
                return f"{path} is not what was written (sha256 differs)"
        if extra := _paths_below(root) - {f.path for f in manifest.files}:
            return f"{root} holds files of nobody's: {sorted(extra)[:3]}"
        return None

    def quarantine(self, digest: Digest) -> None:
        """Take a bad object out of sight, keeping its bytes for a look."""
        path = self.object_path(digest)
        if path.exists():
            target = Path(tempfile.mkdtemp(dir=self.root / "quarantine")) / path.name
            path.rename(target)

    def record_path(self, key: Digest) -> Path:
        return self.root / "keys" / f"{key.removeprefix('sha256:')}.json"

    def commit(self, record: Record) -> Record:
        """Make a result visible. The first writer of a key wins; everybody gets the winner's record."""
        path = self.record_path(record.key)
        with tempfile.NamedTemporaryFile(dir=self.root / "tmp", delete=False) as file:
            file.write(canonical_json(record.model_dump(mode="json")))
            file.flush()
            os.fsync(file.fileno())
        staged = Path(file.name)
        try:
            path.hardlink_to(staged)
        except FileExistsError:
            pass
        finally:
            staged.unlink()
        _fsync(path.parent)
        return Record.model_validate_json(path.read_bytes())

    def lookup(self, key: Digest, *, verify: bool = True) -> Record | None:
        """The committed result of a key, if all its outputs are whole; else None, and what is bad is put away."""
        path = self.record_path(key)
        try:
            record = Record.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            return None
        except ValidationError:
            self._retire(path)
            return None
        for digest in record.outputs.values():
            if not self.object_path(digest).is_dir():
                self._retire(path)
                return None
            if verify and self.damage(digest) is not None:
                self.quarantine(digest)
                self._retire(path)
                return None
        return record

    def forget(self, key: Digest) -> None:
        """Drop a key so that it is computed again (`--force`); its objects stay until gc."""
        self._retire(self.record_path(key))

    def _retire(self, path: Path) -> None:
        if path.exists():
            path.rename(Path(tempfile.mkdtemp(dir=self.root / "quarantine")) / path.name)

    def records(self) -> Iterator[Record]:
        """Every committed result that can be read."""
        for path in sorted((self.root / "keys").glob("*.json")):
            with contextlib.suppress(ValidationError):
                yield Record.model_validate_json(path.read_bytes())

    def work_folder(self, key: Digest) -> Path:
        """Where a run keeps its checkpoints until it commits; the same folder after a kill."""
        path = self.root / "work" / key.removeprefix("sha256:")
        path.mkdir(exist_ok=True)
        return path

    def drop_work(self, key: Digest) -> None:
        shutil.rmtree(self.root / "work" / key.removeprefix("sha256:"), ignore_errors=True)

    @contextlib.contextmanager
    def lock(self, name: str) -> Generator[None]:
        """Hold an exclusive lock; waits for whoever has it."""
        path = self.root / "locks" / name.removeprefix("sha256:")
        with path.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def locked(self, name: str) -> bool:
        """Whether somebody holds a lock at this moment."""
        path = self.root / "locks" / name.removeprefix("sha256:")
        if not path.exists():
            return False
        with path.open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
        return False

    def sweep_tmp(self) -> None:
        """Remove private folders whose process is gone."""
        for path in (self.root / "tmp").iterdir():
            owner = path.name.split("-")[0]
            if owner.isdigit() and not Path(f"/proc/{owner}").exists():
                shutil.rmtree(path, ignore_errors=True)


def _paths_below(root: Path) -> set[str]:
    files = {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}
    return files - {MANIFEST}


def _fsync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
