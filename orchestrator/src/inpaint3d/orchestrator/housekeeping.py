"""Keeping a store in order: verifying it, freeing space, and telling where an artifact comes from."""

import shutil
from pathlib import Path
from typing import Any

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.code import CODE_FOLDER, code_path
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.store import Record, Store, key_path
from inpaint3d.orchestrator.history import History


def verify(store: Store) -> list[str]:
    """Hash every object; what is damaged goes to quarantine. Returns one line for each."""
    lines: list[str] = []
    for digest in store.objects():
        if (damage := store.find_damage(digest)) is not None:
            store.quarantine(digest)
            lines.append(damage)
    return lines


def collect(store: Store, *, keep: int, dry_run: bool) -> tuple[int, int]:
    """Remove what the last `keep` runs of each name, and the last `keep` whole ones, do not need.

    Returns bytes and artifacts freed. RetryableError while a run uses the store: what it has just committed is named by
    no record yet.
    """
    with store.exclusive():
        return _collect(store, keep, dry_run=dry_run)


def _collect(store: Store, keep: int, *, dry_run: bool) -> tuple[int, int]:
    keys, objects = _needed(store, keep)
    gone = [d for d in store.objects() if d not in objects]
    records = list(store.records())
    stale = [r.key for r in records if r.key not in keys]
    litter = [p for folder in ("work", "quarantine") for p in (store.root / folder).iterdir()]
    freed = sum(map(store.size, gone)) + sum(map(_size, litter))
    if not dry_run:
        store.sweep_tmp()
        for key in stale:  # keys first: a kill in between leaves no key without its objects
            store.remove(key_path(key))
        for path in _find_stale_listings(store, [r for r in records if r.key in keys]):
            store.remove(path)
        for digest in gone:
            store.drop_object(digest)
        for path in litter:
            shutil.rmtree(path)
    return freed, len(gone)


def _find_stale_listings(store: Store, kept: list[Record]) -> list[str]:
    """What lies behind the code of results that are not kept."""
    named = {code_path(r.components["code"]) for r in kept if "code" in r.components}
    return [path for name in store.names(CODE_FOLDER) if (path := f"{CODE_FOLDER}/{name}") not in named]


def _needed(store: Store, keep: int) -> tuple[set[Digest], set[Digest]]:
    history = History(store)
    keys: set[Digest] = set()
    objects: set[Digest] = set()
    for name in history.names():
        whole = 0
        for i, record in enumerate(history.of(name)):
            # A run that failed or was killed early names little: the last whole ones are kept besides.
            whole += record.status == "done"
            if i < keep or (record.status == "done" and whole <= keep):
                objects |= set(record.externals.values())
                keys |= {n.key for n in record.nodes if n.key is not None}
                objects |= {d for n in record.nodes for d in n.outputs.values()}
    return keys, objects


def _size(path: Path) -> int:
    return sum(p.stat().st_size for p in path.rglob("*") if p.is_file())


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
    return _branch(start, by_output, externals, 0)


def _branch(record: Record, by_output: dict[Digest, Record], externals: dict[Digest, str], depth: int) -> list[str]:
    outputs = ", ".join(f"{port} {digest[7:19]}" for port, digest in record.outputs.items())
    lines = [f"{'  ' * depth}{record.stage} -> {outputs}"]
    inputs: dict[str, Any] = record.components["inputs"]
    for port, digests in inputs.items():
        for digest in [digests] if isinstance(digests, str) else digests:
            if digest in by_output:
                lines += _branch(by_output[digest], by_output, externals, depth + 1)
            else:
                lines.append(f"{'  ' * (depth + 1)}{port}: {externals.get(digest, 'from outside')} {digest[7:19]}")
    return lines
