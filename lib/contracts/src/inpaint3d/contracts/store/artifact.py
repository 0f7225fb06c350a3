"""What a store holds: artifacts, and the records of the runs that made them. Also artifacts outside any store."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import ValidationError

from inpaint3d.contracts.errors import ArtifactError, ConfigurationError
from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.canonical import canonical_json, digest_of_chunks, file_digest
from inpaint3d.contracts.models.manifest import MANIFEST, Manifest, first_error, is_compatible, read_metadata

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

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the result cannot be right, as its stage measured; empty where nothing speaks against it."""
        return tuple(self.timings.get("doubts", ()))

    def encode(self) -> bytes:
        """The file's bytes: the record's canonical JSON, with the digest of all the rest in it.

        Keys are sorted, so that the components come first, the digest second.
        """
        components = canonical_json(self.components)
        rest = canonical_json(self.model_dump(mode="json", exclude={"components"}))[1:]
        digest = digest_of_chunks([_HEAD, components, b",", rest])
        return b'%b%b,"digest":"%b",%b' % (_HEAD, components, digest.encode(), rest)

    @classmethod
    def decode(cls, data: bytes, key: Digest) -> "Record":
        """The record of a key, every byte of it as `encode` wrote it. ArtifactError says what is wrong with it.

        What stands there is hashed, not encoded again: planning for many scenes does nothing as often as this.
        """
        try:
            components, written, digest, rest = _split(data)
            record = cls.model_validate({**_DECODER.decode("{" + rest.decode()), "components": components})
        except (ValueError, TypeError, RecursionError) as error:
            raise ArtifactError("not a record that this version writes") from error
        if digest_of_chunks([_HEAD, written, b",", rest]) != digest:
            raise ArtifactError("changed since it was written: it does not hash to its digest")
        if record.key != key:
            raise ArtifactError(f"the record of another key, {record.key}")
        if digest_of_chunks([written]) != key:
            raise ArtifactError("its components do not give its key")
        return record


_HEAD = b'{"components":'
_DIGEST = re.compile(r',"digest":"(sha256:[0-9a-f]{64})",')
_DECODER = json.JSONDecoder()


def _split(data: bytes) -> tuple[Any, bytes, Digest, bytes]:
    """The parts of an encoded record: components, the bytes that say them, digest, the bytes behind it.

    ValueError where it is none.
    """
    text = data.decode()
    if not data.startswith(_HEAD):
        raise ValueError("it does not begin with components")
    components, end = _DECODER.raw_decode(text, len(_HEAD))
    if (digest := _DIGEST.match(text, end)) is None:
        raise ValueError("it has no digest")
    return components, text[len(_HEAD) : end].encode(), digest[1], text[digest.end() :].encode()


def load_manifest(folder: Path, schema: str) -> Manifest:
    """The manifest of an artifact in a folder of its own, outside any store; its files are not looked at.

    Raises ConfigurationError where the folder holds none, ArtifactError where it is of another schema.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise ConfigurationError(f"{folder} holds no {MANIFEST}; give the folder of a {schema} artifact")
    manifest = parse_manifest(path.read_bytes(), str(path))
    if not is_compatible(manifest.schema_id, schema):
        raise ArtifactError(f"{folder} is {manifest.schema_id}, but {schema} is wanted here")
    return manifest


def load_artifact(folder: Path, schema: str, model: type[M]) -> Artifact[M]:
    """An artifact in a folder of its own, verified. Raises as `load_manifest`, and ArtifactError for damage."""
    manifest = load_manifest(folder, schema)
    if damage := find_folder_damage(folder, manifest.digest):
        raise ArtifactError(damage)
    return Artifact(folder, manifest.digest, manifest, read_metadata(manifest, model))


def find_folder_damage(root: Path, digest: Digest) -> str | None:
    """What is wrong with an artifact's folder (bytes against its digest), or None."""
    try:
        manifest = parse_manifest((root / MANIFEST).read_bytes(), str(root / MANIFEST))
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
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
    if extra := _list_files(root) - {f.path for f in manifest.files}:
        return f"{root} holds files of nobody's: {sorted(extra)[:3]}"
    return None


def parse_manifest(data: bytes, where: str) -> Manifest:
    """The manifest that these bytes are; ArtifactError naming `where` they lie if they are none."""
    try:
        return Manifest.model_validate_json(data)
    except ValidationError as error:
        raise ArtifactError(f"{where} is not a manifest ({first_error(error)}); run the pipeline again") from error


def _list_files(root: Path) -> set[str]:
    files = {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}
    return files - {MANIFEST}


def object_file(digest: Digest, relative: str) -> str:
    """Where a store keeps a file of an artifact."""
    return f"objects/{hex_of(digest)}/{relative}"


def key_path(key: Digest) -> str:
    """Where a store keeps the record of a key."""
    return f"keys/{hex_of(key)}.json"


def key_of(name: str) -> Digest:
    """The key whose record a file below `keys/` is."""
    return f"sha256:{name.removesuffix('.json')}"


def hex_of(digest: Digest) -> str:
    """A digest as a file's name."""
    return digest.removeprefix("sha256:")
