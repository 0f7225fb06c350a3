"""The content-addressed store: artifacts by digest, results by key, visible whole or not at all.

    objects/DIGEST/         an artifact: artifact.json and its files, read-only once there
    keys/KEY.json           the commit point: key -> output digests, components, provenance, times. Immutable
    work/KEY/               checkpoints of a run that has not committed yet
    runs/NAME/ID.json       records of runs
    tmp/  locks/  quarantine/

Commit: write in a private folder below tmp/ -> validate -> hash -> fsync -> rename into objects/ -> fsync the folder ->
link keys/KEY.json, last. A kill at any point leaves either nothing visible or everything.

`Store` is a local folder; `bucket.BucketStore` keeps the same layout in a bucket. `open_store` tells them apart.
"""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NoReturn, TypeVar

from pydantic import ValidationError

from inpaint3d.contracts.canonical import canonical_json, file_digest
from inpaint3d.contracts.errors import ArtifactError, ConfigurationError, RetryableError, from_os_error
from inpaint3d.contracts.manifest import (
    MANIFEST,
    Manifest,
    build_manifest,
    compatible,
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


def manifest_in(folder: Path, schema: str) -> Manifest:
    """The manifest of an artifact in a folder of its own, outside any store; its files are not looked at.

    Raises ConfigurationError where the folder holds none, ArtifactError where it is of another schema.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise ConfigurationError(f"{folder} holds no {MANIFEST}; give the folder of a {schema} artifact")
    manifest = _parsed_manifest(path.read_bytes(), str(path))
    if not compatible(manifest.schema_id, schema):
        raise ArtifactError(f"{folder} is {manifest.schema_id}, but {schema} is wanted here")
    return manifest


def artifact_in(folder: Path, schema: str, model: type[M]) -> Artifact[M]:
    """An artifact in a folder of its own, verified. Raises as `manifest_in`, and ArtifactError for damage."""
    manifest = manifest_in(folder, schema)
    if damage := folder_damage(folder, manifest.digest):
        raise ArtifactError(damage)
    return Artifact(folder, manifest.digest, manifest, read_metadata(manifest, model))


class Record(Closed):
    """`keys/KEY.json`: what a key produced, and how. Only `outputs` matters to those who reuse it."""

    key: Digest
    stage: str
    components: dict[str, Any]
    outputs: dict[str, Digest]
    provenance: dict[str, Any]
    timings: dict[str, Any]


def open_store(place: str) -> "Store":
    """The store at a place: `s3://BUCKET/PREFIX`, or a local folder."""
    if place.startswith("s3://"):
        from inpaint3d.contracts.bucket import BucketStore  # its client library is loaded where it is needed

        return BucketStore(place)
    if "://" in place:
        raise ConfigurationError(f"--store {place}: a store is a folder or s3://BUCKET/PREFIX")
    return Store(Path(place))


class Store:
    """A store in a local folder. Safe for many processes; locks are flock and die with their holder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.place = str(root.resolve())
        try:
            for name in ("objects", "keys", "work", "tmp", "locks", "quarantine"):
                (root / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise from_os_error(error) from error

    def object_path(self, digest: Digest) -> Path:
        return self.root / "objects" / hex_of(digest)

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
            if folder_damage(target, manifest.digest) is None:  # somebody was first with the same bytes
                shutil.rmtree(folder)
            else:
                self._discard(target)
                folder.rename(target)
        _fsync(target.parent)
        return manifest.digest

    def manifest(self, digest: Digest) -> Manifest:
        """The manifest of an artifact; ArtifactError where it is not there, or is none."""
        path = object_file(digest, MANIFEST)
        if (data := self.read(path)) is None:
            raise ArtifactError(f"artifact {digest} is not in the store {self.place}; run the pipeline again")
        return _parsed_manifest(data, f"{self.place}/{path}")

    def open(self, digest: Digest, model: type[M]) -> Artifact[M]:
        """Open a verified artifact. A damaged one is quarantined and reported, never read."""
        root = self.fetch(digest)
        manifest = Manifest.model_validate_json((root / MANIFEST).read_bytes())
        return Artifact(root, digest, manifest, read_metadata(manifest, model))

    def fetch(self, digest: Digest) -> Path:
        """The folder of an artifact on this machine, verified. A damaged one is quarantined and reported."""
        if (damage := self.damage(digest)) is not None:
            self._refuse(digest, damage)
        return self.object_path(digest)

    def _refuse(self, digest: Digest, damage: str) -> NoReturn:
        self.quarantine(digest)
        raise ArtifactError(f"{damage}; it was moved to quarantine, run the pipeline again to recompute it")

    def damage(self, digest: Digest) -> str | None:
        """What is wrong with a stored artifact (bytes against its digest), or None."""
        if not self.present(digest):
            return f"artifact {digest} is not in the store {self.place}"
        return folder_damage(self.object_path(digest), digest)

    def whole(self, digest: Digest) -> bool:
        """Whether an artifact is there and is what was written, as far as this store can tell without moving it."""
        return self.damage(digest) is None

    def present(self, digest: Digest) -> bool:
        """Whether an artifact is there; says nothing of its bytes."""
        return self.object_path(digest).is_dir()

    def objects(self) -> Iterator[Digest]:
        """Every artifact in the store."""
        for name in self.names("objects"):
            yield f"sha256:{name}"

    def size(self, digest: Digest) -> int:
        """Bytes that an artifact takes."""
        return sum(p.stat().st_size for p in self.object_path(digest).rglob("*") if p.is_file())

    def drop_object(self, digest: Digest) -> None:
        shutil.rmtree(self.object_path(digest))

    def quarantine(self, digest: Digest) -> None:
        """Take a bad object out of sight, keeping its bytes for a look."""
        if self.present(digest):
            self._discard(self.object_path(digest))

    def _discard(self, path: Path) -> None:
        path.rename(Path(tempfile.mkdtemp(dir=self.root / "quarantine")) / path.name)

    def read(self, path: str) -> bytes | None:
        """A small document by its path in the store, or None."""
        try:
            return (self.root / path).read_bytes()
        except FileNotFoundError:
            return None

    def write(self, path: str, data: bytes) -> None:
        """Write a small document, replacing the one there; readers see either whole."""
        target = self.root / path
        target.parent.mkdir(parents=True, exist_ok=True)
        self._stage(data).replace(target)

    def create(self, path: str, data: bytes) -> bool:
        """Write a small document where there is none. Of many writers one wins; the others get False."""
        staged = self._stage(data)
        try:
            (self.root / path).hardlink_to(staged)
        except FileExistsError:
            return False
        finally:
            staged.unlink()
        _fsync((self.root / path).parent)
        return True

    def _stage(self, data: bytes) -> Path:
        with tempfile.NamedTemporaryFile(dir=self.root / "tmp", prefix=f"{os.getpid()}-", delete=False) as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        return Path(file.name)

    def retire(self, path: str) -> None:
        """Take a document out of sight, keeping it in quarantine."""
        if (self.root / path).exists():
            self._discard(self.root / path)

    def remove(self, path: str) -> None:
        (self.root / path).unlink(missing_ok=True)

    def names(self, folder: str) -> list[str]:
        """What lies directly below a folder, sorted; nothing where there is no such folder."""
        path = self.root / folder
        return sorted(p.name for p in path.iterdir()) if path.is_dir() else []

    def commit(self, record: Record) -> Record:
        """Make a result visible. The first writer of a key wins; everybody gets the winner's record."""
        data = canonical_json(record.model_dump(mode="json"))
        self.create(key_path(record.key), data)
        return Record.model_validate_json(self.read(key_path(record.key)) or data)

    def lookup(self, key: Digest, *, verify: bool = True) -> Record | None:
        """The committed result of a key, if all its outputs are whole; else None, and what is bad is put away."""
        if (data := self.read(key_path(key))) is None:
            return None
        try:
            record = Record.model_validate_json(data)
        except ValidationError:
            self.retire(key_path(key))
            return None
        for digest in record.outputs.values():
            if not (self.whole(digest) if verify else self.present(digest)):
                self.quarantine(digest)
                self.retire(key_path(key))
                return None
        return record

    def forget(self, key: Digest) -> None:
        """Drop a key so that it is computed again (`--force`); its objects stay until gc."""
        self.retire(key_path(key))

    def records(self) -> Iterator[Record]:
        """Every committed result that can be read."""
        for name in self.names("keys"):
            with contextlib.suppress(ValidationError):
                yield Record.model_validate_json(self.read(f"keys/{name}") or b"")

    def work_folder(self, key: Digest) -> Path:
        """Where a run keeps its checkpoints until it commits; the same folder after a kill."""
        path = self.root / "work" / hex_of(key)
        path.mkdir(exist_ok=True)
        return path

    def drop_work(self, key: Digest) -> None:
        shutil.rmtree(self.root / "work" / hex_of(key), ignore_errors=True)

    @contextlib.contextmanager
    def lock(self, name: str) -> Generator[None]:
        """Hold an exclusive lock; waits for whoever has it."""
        path = self.root / "locks" / hex_of(name)
        with path.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    @contextlib.contextmanager
    def in_use(self) -> Generator[None]:
        """Keep `alone` away. Whoever writes or reads results holds it; any number may at a time."""
        with (self.root / "locks" / "in-use").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_SH)
            yield

    @contextlib.contextmanager
    def alone(self) -> Generator[None]:
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


def object_file(digest: Digest, relative: str) -> str:
    """Where the store keeps a file of an artifact."""
    return f"objects/{hex_of(digest)}/{relative}"


def folder_damage(root: Path, digest: Digest) -> str | None:
    """What is wrong with an artifact's folder (bytes against its digest), or None."""
    try:
        manifest = _parsed_manifest((root / MANIFEST).read_bytes(), str(root / MANIFEST))
    except FileNotFoundError:
        return f"{root / MANIFEST} is missing"
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


def _parsed_manifest(data: bytes, where: str) -> Manifest:
    try:
        return Manifest.model_validate_json(data)
    except ValidationError as error:
        raise ArtifactError(f"{where} is not a manifest ({first_error(error)}); run the pipeline again") from error


def key_path(key: Digest) -> str:
    """Where the store keeps the record of a key."""
    return f"keys/{hex_of(key)}.json"


def hex_of(digest: Digest) -> str:
    """A digest as a file's name."""
    return digest.removeprefix("sha256:")


def _paths_below(root: Path) -> set[str]:
    files = {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}
    return files - {MANIFEST}


def _fsync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
