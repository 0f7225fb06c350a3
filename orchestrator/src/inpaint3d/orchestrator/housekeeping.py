"""Keeping a store in order: verifying it, freeing space, and telling where an artifact comes from."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from inpaint3d.contracts.errors import ArtifactError, ConfigurationError
from inpaint3d.contracts.kit.code import CODE_FOLDER, code_path
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import digest_of_chunks
from inpaint3d.contracts.models.manifest import first_error
from inpaint3d.contracts.models.report import RunRecord, read_run_document
from inpaint3d.contracts.store import Record, Store, key_of, key_path
from inpaint3d.contracts.store.workspace import remove
from inpaint3d.orchestrator.history import History

SUBMISSIONS, MASKS = "submissions", "masks"
_REPAIR = "restore it from a copy, or remove it if its results may go"


@dataclass(frozen=True)
class Damage:
    """Something in a store that is not what it should be, and how to mend it, where that can be done."""

    what: str
    mend: Callable[[], None] | None


def find_damage(store: Store) -> Iterator[Damage]:
    """Hash every artifact, record and listing; what is not what was written, and keys whose artifacts are gone."""
    damaged: set[Digest] = set()
    for digest in store.objects():
        if (damage := store.find_damage(digest)) is not None:
            damaged.add(digest)
            yield Damage(damage, partial(store.quarantine, digest))
    for name in store.names("keys"):
        if (fault := _find_key_fault(store, key_of(name), damaged)) is not None:
            yield Damage(f"{store.place}/keys/{name}: {fault}", partial(store.retire, f"keys/{name}"))
    for name in store.names(CODE_FOLDER):
        path = f"{CODE_FOLDER}/{name}"
        if digest_of_chunks([store.read(path) or b""]) != f"sha256:{name.removesuffix('.json')}":
            yield Damage(f"{store.place}/{path} does not hash to its name", partial(store.retire, path))
    for path, data in _list_run_documents(store):
        try:
            read_needs(data)
        except ValueError as error:
            yield Damage(f"{store.place}/{path} cannot be read ({error}): {_REPAIR}", None)


def _find_key_fault(store: Store, key: Digest, damaged: set[Digest]) -> str | None:
    try:
        record = Record.decode(store.read(key_path(key)) or b"", key)
    except ArtifactError as error:
        return str(error)
    for port, digest in record.outputs.items():
        if digest in damaged or not store.is_present(digest):
            return f"its {port} {digest} is {'damaged' if digest in damaged else 'gone'}"
    return None


def collect(store: Store, *, keep: int, dry_run: bool) -> tuple[int, int]:
    """Remove what the last `keep` runs of each name, and the last `keep` whole ones, do not need.

    Returns bytes and artifacts freed. RetryableError while a run uses the store: what it has just committed is named by
    no record yet. ArtifactError, and nothing is removed, where a run's record cannot be read: it may need anything.
    """
    with store.exclusive():
        return _collect(store, keep, dry_run=dry_run)


def _collect(store: Store, keep: int, *, dry_run: bool) -> tuple[int, int]:
    keys, objects = _find_needed(store, keep)
    gone = [d for d in store.objects() if d not in objects]
    records = list(store.records())
    stale = [r.key for r in records if r.key not in keys]
    litter = store.list_litter()
    freed = sum(map(store.size, gone)) + sum(map(_measure_size, litter))
    if not dry_run:
        store.sweep_tmp()
        for key in stale:  # keys first: a kill in between leaves no key without its objects
            store.remove(key_path(key))
        for path in _find_stale_listings(store, [r for r in records if r.key in keys]):
            store.remove(path)
        for digest in gone:
            store.drop_object(digest)
        for path in litter:
            remove(path)
    return freed, len(gone)


def _find_stale_listings(store: Store, kept: list[Record]) -> list[str]:
    """What lies behind the code of results that are not kept."""
    named = {code_path(r.components["code"]) for r in kept if "code" in r.components}
    return [path for name in store.names(CODE_FOLDER) if (path := f"{CODE_FOLDER}/{name}") not in named]


class _NodeNeeds(BaseModel):
    key: Digest | None = None
    outputs: dict[str, Digest] = {}


class _Needs(BaseModel):
    """What the record of a run says of what it needs, in whatever version it was written: other fields are ignored."""

    status: str
    externals: dict[str, Digest]
    nodes: tuple[_NodeNeeds, ...]


@dataclass(frozen=True)
class RunNeeds:
    """What a run needs to be kept. `known` is False where a newer version wrote it, which may know of more."""

    whole: bool
    known: bool
    keys: set[Digest]
    objects: set[Digest]


def read_needs(data: bytes) -> RunNeeds:
    """What the run of a record needs. ValueError where that cannot be told.

    Of a record with fields that this version does not know, every digest that stands anywhere in it is needed.
    """
    body = read_run_document(data)
    try:
        needs = _Needs.model_validate(body)
    except ValidationError as error:
        raise ValueError(first_error(error)) from error
    try:
        RunRecord.model_validate(body)
    except ValidationError:
        named = _find_digests(data)
        return RunNeeds(whole=False, known=False, keys=named, objects=named)
    return RunNeeds(
        whole=needs.status == "done",
        known=True,
        keys={n.key for n in needs.nodes if n.key is not None},
        objects={*needs.externals.values(), *(d for n in needs.nodes for d in n.outputs.values())},
    )


def _find_needed(store: Store, keep: int) -> tuple[set[Digest], set[Digest]]:
    """Keys and artifacts that are to be kept; ArtifactError for a record that cannot be read."""
    history = History(store)
    keys: set[Digest] = set()
    objects = _find_submitted(store)
    for name in history.names():
        seen = whole = 0
        for path, data in history.documents(name):
            try:
                needs = read_needs(data)
            except ValueError as error:
                raise ArtifactError(
                    f"{store.place}/{path} cannot be read ({error}), and what it needs is not known: "
                    f"nothing was removed; {_REPAIR}"
                ) from error
            # A run that failed or was killed early names little: the last whole ones are kept besides.
            seen, whole = seen + needs.known, whole + needs.whole
            if not needs.known or seen <= keep or (needs.whole and whole <= keep):
                objects |= needs.objects
                keys |= needs.keys
    return keys, objects


def _find_submitted(store: Store) -> set[Digest]:
    """What scenes read that were handed to a cluster, whether they have run yet or not."""
    paths = [f"{SUBMISSIONS}/{file}" for file in store.names(SUBMISSIONS)]
    paths += [f"{MASKS}/{name}/{scene}" for name in store.names(MASKS) for scene in store.names(f"{MASKS}/{name}")]
    return {digest for path in paths for digest in _find_digests(store.read(path) or b"")}


def _find_digests(data: bytes) -> set[Digest]:
    return {found.decode() for found in re.findall(rb"sha256:[0-9a-f]{64}", data)}


def _list_run_documents(store: Store) -> Iterator[tuple[str, bytes]]:
    history = History(store)
    for name in history.names():
        yield from history.documents(name)


def _measure_size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() and not path.is_symlink() else [path]
    return sum(p.lstat().st_size for p in files if p.is_file())


def trace_lineage(store: Store, record: RunRecord, stage: str) -> list[str]:
    """An indented tree: the stage, its parameters, and below it the stages whose results it read."""
    by_output: dict[Digest, Record] = {d: r for r in store.records() for d in r.outputs.values()}
    found = [n for n in record.nodes if n.node == stage]
    if not found or found[0].key is None:
        raise ConfigurationError(
            f"{stage} has no result in {record.name}; `inpaint3d show {record.name}` lists what has"
        )
    start = store.lookup(found[0].key, verify=False)
    if start is None:
        raise ConfigurationError(f"the result of {stage} is gone from the store; run {record.name} again")
    externals = {d: name for name, d in record.externals.items()}
    return _list_branch(start, by_output, externals, 0)


def _list_branch(
    record: Record, by_output: dict[Digest, Record], externals: dict[Digest, str], depth: int
) -> list[str]:
    outputs = ", ".join(f"{port} {digest[7:19]}" for port, digest in record.outputs.items())
    lines = [f"{'  ' * depth}{record.stage} -> {outputs}"]
    inputs: dict[str, Any] = record.components["inputs"]
    for port, digests in inputs.items():
        for digest in [digests] if isinstance(digests, str) else digests:
            if digest in by_output:
                lines += _list_branch(by_output[digest], by_output, externals, depth + 1)
            else:
                lines.append(f"{'  ' * (depth + 1)}{port}: {externals.get(digest, 'from outside')} {digest[7:19]}")
    return lines
