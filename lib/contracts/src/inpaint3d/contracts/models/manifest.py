"""`artifact.json`: what an artifact is, its files with sizes and digests, and its metadata."""

from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

from pydantic import Field, StringConstraints, ValidationError

from inpaint3d.contracts.errors import ArtifactError
from inpaint3d.contracts.models.artifacts import SCHEMAS
from inpaint3d.contracts.models.base import Closed, Digest, RelativePath, StoredPath
from inpaint3d.contracts.models.canonical import digest_of, file_digest

MANIFEST = "artifact.json"
M = TypeVar("M", bound=Closed)
Location = tuple[int | str, ...]

SchemaId = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9-]*@\d+\.\d+$")]

# By suffix and not by the machine's mime tables, which differ: equal artifacts must have equal manifests.
MEDIA_TYPES = {
    ".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".exr": "image/x-exr", ".tif": "image/tiff",
    ".safetensors": "application/vnd.safetensors", ".csv": "text/csv", ".json": "application/json",
    ".html": "text/html", ".usdz": "model/vnd.usdz+zip", ".usdc": "model/vnd.usd", ".onnx": "application/onnx",
}  # fmt: skip


class FileEntry(Closed):
    """One file of an artifact."""

    path: RelativePath
    mediaType: str  # noqa: N815 - the OCI spelling
    sha256: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
    size: Annotated[int, Field(ge=0)]


class Manifest(Closed):
    """The whole of `artifact.json`. Its canonical JSON is what the artifact's digest is taken over."""

    schema_id: SchemaId = Field(alias="schema")
    files: tuple[FileEntry, ...]
    metadata: dict[str, Any]

    def dump(self) -> dict[str, Any]:
        return self.model_dump(mode="json", by_alias=True)

    @property
    def digest(self) -> Digest:
        """`sha256:…` of the content: schema, files and metadata; no times, no provenance."""
        return digest_of(self.dump())


def schema_id(name: str) -> str:
    """`name@MAJOR.MINOR` that this code writes."""
    return f"{name}@{SCHEMAS[name][0]}"


def split_schema(schema: str) -> tuple[str, int, int | None]:
    """`name@1.0` -> (name, 1, 0); `name@1` -> (name, 1, None)."""
    name, _, version = schema.partition("@")
    major, _, minor = version.partition(".")
    return name, int(major), int(minor) if minor else None


def is_compatible(written: str, wanted: str) -> bool:
    """Whether a reader of `wanted` (`name@MAJOR`) takes an artifact `written` as `name@MAJOR.MINOR`."""
    return split_schema(written)[:2] == split_schema(wanted)[:2]


def describe_files(root: Path) -> tuple[FileEntry, ...]:
    """Every file below `root` but the manifest itself, sorted by path, with size and sha256."""
    return tuple(describe_file(root, p) for p in sorted(root.rglob("*")) if p.is_file() and p != root / MANIFEST)


def describe_file(root: Path, path: Path) -> FileEntry:
    """One file below `root`, with size and sha256."""
    return FileEntry(
        path=path.relative_to(root).as_posix(),
        mediaType=MEDIA_TYPES.get(path.suffix.lower(), "application/octet-stream"),
        sha256=file_digest(path).removeprefix("sha256:"),
        size=path.stat().st_size,
    )


def build_manifest(root: Path, name: str, metadata: Closed) -> Manifest:
    """The manifest of a folder that a stage has filled, checked against the schema's model and its own files.

    Raises ArtifactError where the metadata is of another schema, or names a file that is not there.
    """
    version, model = SCHEMAS[name]
    if type(metadata) is not model:
        raise ArtifactError(f"{name}@{version} wants metadata {model.__name__}, got {type(metadata).__name__}")
    data = metadata.model_dump(mode="json")
    check_metadata(name, data)
    files = describe_files(root)
    present = {f.path for f in files}
    for path in list_named_files(metadata):
        if path not in present:
            raise ArtifactError(f"{name}: metadata names {path}, which was not written")
    return Manifest(schema=schema_id(name), files=files, metadata=data)


def list_named_files(metadata: Closed) -> list[StoredPath]:
    """Every path that the metadata names, wherever it stands."""
    found: list[StoredPath] = []

    def visit(value: object) -> None:
        if isinstance(value, Closed):
            for field in type(value).model_fields:
                visit(getattr(value, field))
        elif isinstance(value, tuple):
            for item in cast(tuple[object, ...], value):
                visit(item)
        elif isinstance(value, StoredPath):
            found.append(value)

    visit(metadata)
    return found


def check_metadata(name: str, data: dict[str, Any]) -> Closed:
    """Strict reading of what is about to be written: closed, finite, no unknown field."""
    version, model = SCHEMAS[name]
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ArtifactError(f"metadata of {name}@{version} is not valid: {first_error(error)}") from error


def read_metadata(manifest: Manifest, model: type[M]) -> M:
    """Metadata of a stored artifact; fields that a newer minor added are ignored."""
    data = manifest.metadata
    try:
        return model.model_validate(data)
    except ValidationError as error:
        unknown = [e["loc"] for e in error.errors() if e["type"] == "extra_forbidden"]
        name, _, minor = split_schema(manifest.schema_id)
        if len(unknown) == error.error_count() and (minor or 0) > (split_schema(schema_id(name))[2] or 0):
            return model.model_validate(_drop_fields(data, unknown))
        raise ArtifactError(f"{manifest.schema_id}: {first_error(error)}; re-run the stage that wrote it") from error


def _drop_fields(data: dict[str, Any], unknown: list[Location]) -> dict[str, Any]:
    """The data less the fields at these places. Tags of unions stand in a place but not in the data: passed over."""
    here = {at[0] for at in unknown if len(at) == 1}
    return {key: _drop_below(value, key, unknown) for key, value in data.items() if key not in here}


def _drop_below(value: Any, key: int | str, unknown: list[Location]) -> Any:
    deeper = [at[1:] for at in unknown if at[0] == key and len(at) > 1]
    if isinstance(value, dict):
        fields = cast(dict[str, Any], value)
        return _drop_fields(fields, [at if at[0] in fields or len(at) == 1 else at[1:] for at in deeper])
    if isinstance(value, list):
        return [_drop_below(item, i, deeper) for i, item in enumerate(cast(list[Any], value))]
    return value


def first_error(error: ValidationError) -> str:
    """`at: what (value)` of a validation error's first line, and how many more there are."""
    first, *rest = error.errors(include_url=False)
    at = ".".join(str(p) for p in first["loc"]) or "(whole)"
    more = f" (and {len(rest)} more)" if rest else ""
    value = repr(first.get("input"))
    return f"{at}: {first['msg']}, got {value[:80]}{more}"
