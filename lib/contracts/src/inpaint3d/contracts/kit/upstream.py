"""Running stages of a pipeline on artifacts that the stubs before them made, for tests of what meets what."""

import json
import subprocess
import sys
from collections.abc import Iterable
from typing import Any

from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.models.artifacts import MaskRequestArtifact, Source
from inpaint3d.contracts.models.artifacts.masks import MaskRequest
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.stage import StageSpec
from inpaint3d.contracts.store import Store


class Upstream:
    """A store holding the stub outputs of every stage before one node, and those that came from outside."""

    def __init__(self, pipeline: Pipeline, node: str, store: Store) -> None:
        self.pipeline, self.node, self.store = pipeline, node, store
        self.produced: dict[str, Digest] = store_externals(store)
        self._done: set[str] = set()
        self.prepare(node)

    def prepare(self, node: str) -> None:
        """Run the stub of every stage before a node that has not run yet. AssertionError where one fails."""
        for name in self.pipeline.order:
            if name not in self._done and node in self.pipeline.downstream(name):
                result = invoke(self.pipeline.stages[name], self.store, self.inputs_of(name), stub=True)
                if result.code != 0:
                    raise AssertionError(f"stub of {name} failed: {result.error}\n{result.stderr}")
                self.take(name, result)

    def take(self, node: str, result: "Result") -> None:
        """What a node's run wrote is what its readers get from now on."""
        self._done.add(node)
        self.produced |= {f"{node}.{port}": digest for port, digest in result.outputs.items()}

    def inputs_of(self, node: str) -> dict[str, Any]:
        """Port -> digest (a list for list ports) of what the node reads; absent optional inputs left out."""
        ports = self.pipeline.stages[node].spec.inputs
        found: dict[str, Any] = {}
        for port, references in self.pipeline.references(node).items():
            digests = [self.produced[r] for r in references if r in self.produced]
            if digests:
                found[port] = digests if ports[port].list else digests[0]
        return found

    def readers_of(self, node: str, outputs: Iterable[str]) -> dict[str, list[str]]:
        """Node that reads one of these outputs of a node -> the ports that it does so at, in the pipeline's order."""
        wanted = {f"{node}.{output}" for output in outputs}
        found: dict[str, list[str]] = {}
        for name in self.pipeline.order:
            if ports := [port for port, refs in self.pipeline.references(name).items() if wanted & set(refs)]:
                found[name] = ports
        return found


class Result:
    """What one run of a stage left behind."""

    def __init__(self, process: subprocess.CompletedProcess[str]) -> None:
        self.code, self.stderr = process.returncode, process.stderr
        self.events: list[dict[str, Any]] = [json.loads(line) for line in process.stdout.splitlines()]
        last: dict[str, Any] = self.events[-1] if self.events else {}
        self.outputs: dict[str, Digest] = last.get("outputs", {})
        self.error: str = last.get("message", "")


def build_command(spec: StageSpec, store: Store, invocation: Invocation) -> list[str]:
    """The command line that runs a stage on this machine, its invocation written below the store."""
    folder = store.private_folder()
    (folder / "invocation.json").write_text(invocation.model_dump_json())
    return [
        sys.executable, "-W", "ignore", "-m", spec.spec.module, "run",
        "--store", store.place, "--invocation", str(folder / "invocation.json"),
    ]  # fmt: skip


def invoke(spec: StageSpec, store: Store, inputs: dict[str, Any], **options: Any) -> Result:
    """Run a stage as a process on artifacts of the store; doubtful results are what tiny parameters give."""
    options = {"accept_doubtful": True, **options}
    line = build_command(spec, store, Invocation(inputs=inputs, threads=1, **options))
    return Result(subprocess.run(line, capture_output=True, text=True, check=False))


def store_externals(store: Store) -> dict[str, Digest]:
    """A source and a mask request, as the orchestrator would take them in."""
    folder = store.private_folder()
    (folder / "raw").mkdir()
    (folder / "raw" / "readme.txt").write_text("the stub of capture-ingest does not look")
    source = store.put(folder, "source", Source(name="tiny", kind="folder"))
    request = MaskRequest.model_validate({"mask": {"kind": "sphere", "centre": [0, 0, 0], "radius": 0.3}})
    mask = store.put(store.private_folder(), "mask-request", MaskRequestArtifact(request=request))
    return {"external.capture": source, "external.mask-request": mask}
