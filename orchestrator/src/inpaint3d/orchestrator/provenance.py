"""Proof that the results of a run are what its record says they were made from, link by link, back to the photos."""

import json
from collections.abc import Iterator

from inpaint3d.contracts.errors import ArtifactError
from inpaint3d.contracts.kit.code import code_path
from inpaint3d.contracts.kit.keys import run_key
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.report import NodeRun, RunRecord
from inpaint3d.contracts.store import Record, Store, key_path


def find_unproved(store: Store, record: RunRecord) -> Iterator[str]:
    """What of a run's results does not follow from its record; nothing: all of it does.

    Every artifact hashes to its digest; every result's key follows from what its record says went in; what went in is
    what came out of another node of the run, or came from outside; the source files behind the code are those that the
    key was taken over. A digest proves what was written, not who wrote it.
    """
    known: set[Digest] = set()
    for external, digest in record.externals.items():
        known.add(digest)
        if (damage := store.find_damage(digest)) is not None:
            yield f"external {external}: {damage}"
    for node in record.nodes:
        if node.status in ("done", "cached"):
            yield from (f"{node.node}: {what}" for what in _check_node(store, node, known))
            known |= set(node.outputs.values())


def _check_node(store: Store, node: NodeRun, known: set[Digest]) -> Iterator[str]:
    result = _read_result(store, node)
    if result is None:
        yield f"its key record {node.key} is gone, or is not what was written"
        return
    if run_key(result.components) != node.key or result.components != node.components:
        yield f"its key {node.key} does not follow from what the run's record says went in"
    if result.outputs != node.outputs:
        yield f"the run's record names other results ({node.outputs}) than its key record ({result.outputs})"
    for port, given in result.components["inputs"].items():
        for digest in [given] if isinstance(given, str) else given:
            if digest not in known:
                yield f"its input {port} ({digest}) is nothing that this run made or was given"
    for port, digest in result.outputs.items():
        if (damage := store.find_damage(digest)) is not None:
            yield f"its {port}: {damage}"
    yield from _check_code(store, result.components["code"])


def _read_result(store: Store, node: NodeRun) -> Record | None:
    if node.key is None or (data := store.read(key_path(node.key))) is None:
        return None
    try:
        return Record.decode(data, node.key)
    except ArtifactError:
        return None


def _check_code(store: Store, digest: Digest) -> Iterator[str]:
    """The listing of a code's source files, where there is one: of an image there is none but in its registry."""
    if (data := store.read(code_path(digest))) is None:
        return
    try:
        same = digest_of(json.loads(data)) == digest
    except (ValueError, RecursionError):
        same = False
    if not same:
        yield f"the listing of its code ({code_path(digest)}) is not what was written"
