"""Whether two runs gave the same results: digests, and where they differ, the files."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.report import NodeRun, RunRecord
from inpaint3d.contracts.store import Store

Verdict = Literal["equal", "differs", "may differ", "was asked something else", "has no result"]


@dataclass(frozen=True)
class Row:
    """One output of one node in both runs."""

    node: str
    port: str
    verdict: Verdict
    detail: str = ""


def compare(pipeline: Pipeline, store: Store, one: RunRecord, other_store: Store, other: RunRecord) -> Iterator[Row]:
    """Every output of every node, in order. The code and the machine behind a node are not compared, only what it made.

    A node whose parameters, seed or inputs are not the same in both runs was asked something else; its results say
    nothing.
    """
    there = {n.node: n for n in other.nodes}
    for node in one.nodes:
        twin = there.get(node.node)
        if node.status == "left-out" and (twin is None or twin.status == "left-out"):
            continue
        if twin is None or not (node.outputs and twin.outputs):
            yield Row(node.node, "", "has no result", f"{node.status}, {twin.status if twin else 'not there'}")
        elif different := [n for n in ("parameters", "inputs", "seed") if node.components[n] != twin.components[n]]:
            yield Row(node.node, "", "was asked something else", ", ".join(different))
        else:
            yield from _list_outputs(pipeline, store, node, other_store, twin)


def _list_outputs(pipeline: Pipeline, store: Store, node: NodeRun, other_store: Store, twin: NodeRun) -> Iterator[Row]:
    promise = pipeline.stages[node.node].spec.determinism
    for port in sorted({*node.outputs, *twin.outputs}):
        digest, twins = node.outputs.get(port), twin.outputs.get(port)
        if digest == twins:
            yield Row(node.node, port, "equal", (digest or "")[7:19])
        elif promise == "exact" or digest is None or twins is None:
            yield Row(node.node, port, "differs", _describe_difference(store, digest, other_store, twins))
        else:
            yield Row(node.node, port, "may differ", promise.tolerance)


def _describe_difference(store: Store, digest: Digest | None, other_store: Store, twin: Digest | None) -> str:
    """The files that are not the same, or that it is the metadata."""
    if digest is None or twin is None:
        return "one of the runs did not write it"
    files, twins = ({f.path: f.sha256 for f in s.manifest(d).files} for s, d in ((store, digest), (other_store, twin)))
    paths = sorted(p for p in {*files, *twins} if files.get(p) != twins.get(p))
    return f"{len(paths)} of {len({*files, *twins})} files: {', '.join(paths[:3])}" if paths else "its metadata"
