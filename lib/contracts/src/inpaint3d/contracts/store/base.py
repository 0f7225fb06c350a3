"""The content-addressed store: artifacts by digest, results by key, visible whole or not at all.

    objects/DIGEST/         an artifact: artifact.json and its files, read-only once there
    keys/KEY.json           the commit point: key -> output digests, components, provenance, times, its own digest
    code/DIGEST.json        the source files behind a `code` component, each with its digest. Immutable
    work/KEY/               checkpoints of a run that has not committed yet; work/KEY.owner: whose
    runs/NAME/ID.json       records of runs
    tmp/  locks/  quarantine/

Commit: write in a private folder below tmp/ -> validate -> hash -> fsync -> rename into objects/ -> fsync the folder ->
link keys/KEY.json, last. A kill at any point leaves either nothing visible or everything.

`folder.FolderStore` is all of it on a local disk; `bucket.BucketStore` keeps objects, keys, code and runs in a bucket.
"""

import abc
import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn, TypeVar

from inpaint3d.contracts.errors import ArtifactError
from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.manifest import MANIFEST, Manifest, build_manifest, describe_files, read_metadata
from inpaint3d.contracts.store.artifact import Artifact, Record, key_of, key_path, object_file, parse_manifest
from inpaint3d.contracts.store.workspace import Workspace, note

M = TypeVar("M", bound=Closed)


class Store(Workspace, abc.ABC):
    """What every store does. Safe for many processes."""

    @property
    def is_writable(self) -> bool:
        """Whether anything can be written here, as far as can be told without trying."""
        return True

    @abc.abstractmethod
    def read(self, path: str) -> bytes | None:
        """A small document by its path in the store, or None."""

    @abc.abstractmethod
    def write(self, path: str, data: bytes) -> None:
        """Write a small document, replacing the one there; readers see either whole."""

    @abc.abstractmethod
    def create(self, path: str, data: bytes) -> bool:
        """Write a small document where there is none. Of many writers one wins; the others get False."""

    @abc.abstractmethod
    def retire(self, path: str) -> None:
        """Take a document out of sight, keeping it in quarantine."""

    @abc.abstractmethod
    def remove(self, path: str) -> None:
        """Remove a document, if it is there."""

    @abc.abstractmethod
    def names(self, folder: str) -> list[str]:
        """What lies directly below a folder, sorted; nothing where there is no such folder."""

    @abc.abstractmethod
    def fetch(self, digest: Digest) -> Path:
        """The folder of an artifact on this machine, verified. A damaged one is quarantined and reported."""

    @abc.abstractmethod
    def find_damage(self, digest: Digest) -> str | None:
        """What is wrong with a stored artifact (bytes against its digest), or None."""

    @abc.abstractmethod
    def is_whole(self, digest: Digest) -> bool:
        """Whether an artifact is there and is what was written, as far as this store can tell without moving it."""

    @abc.abstractmethod
    def is_present(self, digest: Digest) -> bool:
        """Whether an artifact is there; says nothing of its bytes."""

    @abc.abstractmethod
    def size(self, digest: Digest) -> int:
        """Bytes that an artifact takes."""

    @abc.abstractmethod
    def drop_object(self, digest: Digest) -> None:
        """Remove an artifact."""

    @abc.abstractmethod
    def quarantine(self, digest: Digest) -> None:
        """Take a bad artifact out of sight, keeping its bytes for a look."""

    @abc.abstractmethod
    def _publish(self, folder: Path, manifest: Manifest) -> Digest:
        """Make a filled private folder an artifact that all who use the store can see."""

    def put(self, folder: Path, name: str, metadata: Closed) -> Digest:
        """Move a filled private folder into the store as an artifact of schema `name`; returns its digest."""
        return self._publish(folder, build_manifest(folder, name, metadata))

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
        return self._publish(folder, manifest)

    def manifest(self, digest: Digest) -> Manifest:
        """The manifest of an artifact; ArtifactError where it is not there, or is none."""
        path = object_file(digest, MANIFEST)
        if (data := self.read(path)) is None:
            raise ArtifactError(f"artifact {digest} is not in the store {self.place}; run the pipeline again")
        return parse_manifest(data, f"{self.place}/{path}")

    def open(self, digest: Digest, model: type[M]) -> Artifact[M]:
        """Open a verified artifact. A damaged one is quarantined and reported, never read."""
        root = self.fetch(digest)
        manifest = Manifest.model_validate_json((root / MANIFEST).read_bytes())
        return Artifact(root, digest, manifest, read_metadata(manifest, model))

    def objects(self) -> Iterator[Digest]:
        """Every artifact in the store."""
        for name in self.names("objects"):
            yield f"sha256:{name}"

    def commit(self, record: Record) -> Record:
        """Make a result visible. The first writer of a key wins; everybody gets the winner's record."""
        if self.create(key_path(record.key), record.encode()):
            return record
        # What stands there instead of a record must not keep a result from being committed.
        if (winner := self._read_record(record.key)) is not None:
            return winner
        self.create(key_path(record.key), record.encode())
        return self._read_record(record.key) or record

    def lookup(self, key: Digest, *, verify: bool = True) -> Record | None:
        """The committed result of a key, if all its outputs are whole; else None, and what is bad is put away."""
        if (record := self._read_record(key)) is None:
            return None
        for port, digest in record.outputs.items():
            if not (self.is_whole(digest) if verify else self.is_present(digest)):
                note(f"{port} of {record.stage} ({digest}) is damaged or gone from {self.place}; computing it again")
                self.quarantine(digest)
                self.retire(key_path(key))
                return None
        return record

    def _read_record(self, key: Digest) -> Record | None:
        """What `keys/KEY.json` says; None where it is not there, or not what a commit of this key wrote: put away."""
        if (data := self.read(key_path(key))) is None:
            return None
        try:
            return Record.decode(data, key)
        except ArtifactError as error:
            note(f"{self.place}/{key_path(key)}: {error}; it was moved to quarantine, its result is computed again")
            self.retire(key_path(key))
            return None

    def forget(self, key: Digest) -> None:
        """Drop a key so that it is computed again (`--force`); its objects stay until gc."""
        self.retire(key_path(key))

    def records(self) -> Iterator[Record]:
        """Every committed result that can be read."""
        for name in self.names("keys"):
            with contextlib.suppress(ArtifactError):
                yield Record.decode(self.read(f"keys/{name}") or b"", key_of(name))

    def _refuse(self, digest: Digest, damage: str) -> NoReturn:
        self.quarantine(digest)
        raise ArtifactError(f"{damage}; it was moved to quarantine, run the pipeline again to recompute it")
