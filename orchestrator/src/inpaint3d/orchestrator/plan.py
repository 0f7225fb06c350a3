"""What a run would do, and why: the key of every node against what the store holds and what the last run used."""

import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.code import code_digest, name_changed_files
from inpaint3d.contracts.kit.keys import Inputs, key_components, run_key
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.cluster import Image
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.report import Change, NodeRun, Status
from inpaint3d.contracts.models.stage import StageSpec
from inpaint3d.contracts.store import Record, Store
from inpaint3d.orchestrator.configure import ConfiguredPipeline
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.intake import MASK_REQUEST, find_unknown_view
from inpaint3d.orchestrator.options import Force, From, Only, Until

NOT_SELECTED = "not selected, and the store has no result"


@dataclass(frozen=True)
class Selection:
    """Which nodes a run is about. Others are used as the store has them."""

    only: Only = None
    start: From = None
    until: Until = None
    force: Force = False

    @property
    def named(self) -> tuple[str, ...]:
        """The nodes that are asked for by name."""
        return tuple(name for name in (self.only, self.start, self.until) if name is not None)

    def nodes(self, pipeline: Pipeline) -> list[str]:
        """The selected nodes in order; ConfigurationError for a name that is not in the pipeline."""
        for name in self.named:
            if name not in pipeline.nodes:
                raise ConfigurationError(f"no stage {name} in {pipeline.path}; there are {', '.join(pipeline.order)}")
        if self.only is not None:
            if self.start is not None or self.until is not None:
                raise ConfigurationError("--only goes with neither --from nor --until; leave one out")
            return [self.only]
        chosen = set(pipeline.order)
        if self.start is not None:
            chosen &= {self.start} | pipeline.downstream(self.start)
        if self.until is not None:
            chosen &= {self.until} | {n for n in pipeline.order if self.until in pipeline.downstream(n)}
        if not chosen:
            raise ConfigurationError(f"no stage lies between --from {self.start} and --until {self.until}; swap them")
        return [n for n in pipeline.order if n in chosen]


@dataclass(frozen=True)
class Task:
    """A node whose inputs are all known: its key, and the stored result if there is one."""

    node: str
    key: Digest
    components: dict[str, Any]
    inputs: Inputs
    record: Record | None
    reason: str
    changes: tuple[Change, ...]
    after: tuple[str, ...]
    """The nodes whose results it reads."""


@dataclass
class Planner:
    """Turns nodes into tasks as their inputs become known."""

    configured: ConfiguredPipeline
    store: Store
    history: History
    name: str
    externals: dict[str, Digest]
    mask: Path | None = None
    """The file that the mask request was read from."""
    device: str = "cpu"
    stub: bool = False
    images: Mapping[str, Image] | None = None
    """What the stages run in, where that is not this machine's own environment: their digests stand for the code."""
    outputs: dict[str, dict[str, Digest]] = field(default_factory=dict[str, dict[str, Digest]])

    @functools.cached_property
    def _before(self) -> dict[str, NodeRun]:
        """What earlier runs of this name had; read once, since all nodes ask."""
        return self.history.last_results(self.name, self.pipeline.order)

    @property
    def pipeline(self) -> Pipeline:
        """The nodes that run."""
        return self.configured.pipeline

    def upstream(self, node: str) -> tuple[str, ...]:
        """The nodes whose results a node reads, in the pipeline's order."""
        direct = self.pipeline.upstream(node)
        return tuple(n for n in self.pipeline.order if n in direct)

    def known(self, node: str) -> bool:
        """Whether everything upstream of the node has a result."""
        return self.pipeline.upstream(node) <= self.outputs.keys()

    def task(self, node: str, *, force: bool = False) -> Task:
        """Key, stored result and reason of a node whose upstream is known."""
        inputs = self._find_inputs(node)
        spec = self.pipeline.stages[node]
        components = key_components(
            spec,
            code=self._digest_code(spec),
            parameters=self.configured.parameters[node],
            inputs=inputs,
            seed=self.configured.seeds[node],
            device=self.device if spec.spec.gpu != "none" else "cpu",
            stub=self.stub,
        )
        key = run_key(components)
        if force:
            self.store.forget(key)
        record = self.store.lookup(key)
        before = self._before.get(node)
        reason, changes = explain(components, key, before, record, force=force)
        named = name_changed_files(changes, self.store)
        return Task(node, key, components, inputs, record, reason, named, self.upstream(node))

    def request_problem(self, node: str) -> str | None:
        """What a node's result shows to be wrong with the mask request, before the stage that reads it has its turn."""
        request = self.externals.get(MASK_REQUEST)
        if request is None or self.stub:  # a stub's frames are made up
            return None
        for port, output in self.pipeline.stages[node].spec.outputs.items():
            if output.schema_id.startswith("capture@") and port in self.outputs[node]:
                return find_unknown_view(self.store, request, self.outputs[node][port], self.mask)
        return None

    def _digest_code(self, spec: StageSpec) -> Digest:
        if self.images is None:
            return code_digest(spec.spec.module)
        if spec.spec.image not in self.images:
            raise ConfigurationError(f"images.yaml has no {spec.spec.image}; run `make images`")
        return self.images[spec.spec.image].digest

    def _find_inputs(self, node: str) -> Inputs:
        ports = self.pipeline.stages[node].spec.inputs
        inputs: Inputs = {}
        for port, references in self.pipeline.references(node).items():
            found = [d for r in references if (d := self._digest(r)) is not None]
            if found:
                inputs[port] = found if ports[port].list else found[0]
            elif not ports[port].optional:
                raise ConfigurationError(f"{node}: nothing at its input {port} ({', '.join(references)})")
        return inputs

    def _digest(self, reference: str) -> Digest | None:
        source, _, name = reference.partition(".")
        return self.externals.get(name) if source == "external" else self.outputs[source].get(name)


def explain(
    components: dict[str, Any], key: Digest, before: NodeRun | None, record: Record | None, *, force: bool
) -> tuple[str, tuple[Change, ...]]:
    """Why a node runs or not, in words, and which components of its key differ from the last run's."""
    changes = () if before is None or before.key == key else find_differences(before.components, components)
    if record is not None:
        return ("up to date" if not changes else "computed before with exactly this key"), changes
    if force:
        return "forced", changes
    if before is None:
        return "never run under this name", ()
    if changes:
        return "changed: " + ", ".join(c.component for c in changes), changes
    return "its result is gone from the store, or was damaged", ()


def find_differences(old: dict[str, Any], new: dict[str, Any], prefix: str = "") -> tuple[Change, ...]:
    """The leaves in which two keys' components differ."""
    found: list[Change] = []
    for name in sorted({*old, *new}):
        was, now = old.get(name), new.get(name)
        if isinstance(was, dict) and isinstance(now, dict):
            found += find_differences(cast(dict[str, Any], was), cast(dict[str, Any], now), f"{prefix}{name}.")
        elif json.dumps(was, sort_keys=True) != json.dumps(now, sort_keys=True):
            found.append(Change(component=prefix + name, old=was, new=now))
    return tuple(found)


def preview(planner: Planner, selection: Selection) -> list[NodeRun]:
    """The dry run: what each node would do. Nodes behind one that runs are 'pending': its bytes are not known yet.

    Raises ConfigurationError where what is known already shows the mask request to be wrong.
    """
    chosen = set(selection.nodes(planner.pipeline))
    rows: list[NodeRun] = []
    for node in planner.pipeline.order:
        waiting = sorted(planner.pipeline.upstream(node) - planner.outputs.keys())
        if waiting:
            reason = f"after {', '.join(waiting)}"
            status: Status = "pending" if node in chosen else "skipped"
            rows.append(NodeRun(node=node, status=status, reason=reason, after=planner.upstream(node)))
            continue
        task = planner.task(node)
        if task.record is not None and not (selection.force and node in chosen):
            planner.outputs[node] = task.record.outputs
            if (problem := planner.request_problem(node)) is not None:
                raise ConfigurationError(problem)
            rows.append(describe_node(task, "cached", record=task.record))
        elif node in chosen:
            rows.append(describe_node(task, "pending", "forced" if selection.force else None))
        else:
            rows.append(describe_node(task, "skipped", NOT_SELECTED))
    return [*rows, *planner.configured.left_out_rows]


def describe_node(task: Task, status: Status, reason: str | None = None, record: Record | None = None) -> NodeRun:
    """A node's run; with its result's record also outputs, and the cost of computing them."""
    made: dict[str, Any] = {}
    if record is not None:
        costs = {name: record.timings.get(name) for name in ("wall_s", "cpu_s", "peak_memory_bytes")}
        non_finite = record.timings.get("non_finite", {})
        made = {"outputs": record.outputs, "non_finite": non_finite, "doubts": record.doubts, **costs}
    return NodeRun(
        node=task.node,
        status=status,
        reason=task.reason if reason is None else reason,
        after=task.after,
        changes=task.changes,
        key=task.key,
        components=task.components,
        **made,
    )


def find_pipeline(given: Path | None) -> Path:
    """`--pipeline`, else the nearest `pipeline.yaml` above the working folder, else the one this code lies beside."""
    if given is not None:
        return given
    here = Path.cwd()
    for folder in (here, *here.parents, *Path(__file__).resolve().parents):
        if (folder / "pipeline.yaml").is_file():
            return folder / "pipeline.yaml"
    raise ConfigurationError("no pipeline.yaml here or above; give one with --pipeline")
