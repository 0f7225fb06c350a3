"""The contract suite: what every stage must do, whatever it computes. `test_contract.py` of a stage is three lines.

    from inpaint3d.contracts.kit.suite import stage_contract
    TestContract = stage_contract(__file__)

Inputs are made by the stubs of the stages upstream in the repository's `pipeline.yaml`, and what a tiny real run writes
is read by the stages downstream.
"""

import ast
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, ClassVar

import pytest

from inpaint3d.contracts.kit.context import Inputs
from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.kit.upstream import Result, Upstream, build_command, invoke
from inpaint3d.contracts.models.artifacts import SCHEMAS, Source
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.documents import load_yaml
from inpaint3d.contracts.models.manifest import split_schema
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.stage import StageSpec, load_stage
from inpaint3d.contracts.store import FolderStore, Store

TENSOR_LIBRARIES = ("torch", "pycolmap", "onnxruntime")
DAMAGED: Digest = "sha256:" + "0" * 64


def list_committed_keys(store: Store) -> set[str]:
    return {r.key for r in store.records()}


def list_tests(file: Path) -> list[str]:
    """The test functions that pytest collects from a file, in classes or not."""
    found: list[str] = []
    for statement in ast.parse(file.read_text()).body:
        inner = statement.body if isinstance(statement, ast.ClassDef) and statement.name.startswith("Test") else ()
        functions = [s for s in (statement, *inner) if isinstance(s, ast.FunctionDef | ast.AsyncFunctionDef)]
        found += [f.name for f in functions if f.name.startswith("test")]
    return found


class StageContract:
    """The tests themselves; `stage_contract` binds them to one stage."""

    folder: ClassVar[Path]

    @pytest.fixture(scope="class")
    @classmethod
    def upstream(cls, tmp_path_factory: pytest.TempPathFactory) -> Upstream:
        repository = cls.folder.parents[1]
        pipeline = Pipeline(repository / "pipeline.yaml").under(None)
        stage = f"stages/{cls.folder.name}"
        node = [n for n in pipeline.order if pipeline.nodes[n].stage == stage][-1]
        return Upstream(pipeline, node, FolderStore(tmp_path_factory.mktemp("store")))

    @pytest.fixture(scope="class")
    @classmethod
    def spec(cls) -> StageSpec:
        return load_stage(cls.folder / "stage.yaml")

    @pytest.fixture(scope="class")
    @classmethod
    def tiny(cls) -> dict[str, Any]:
        path = cls.folder / "tests" / "tiny.yaml"
        return load_yaml(path)[0] or {}

    @pytest.fixture(scope="class")
    @classmethod
    def inputs(cls, upstream: Upstream) -> dict[str, Any]:
        return upstream.inputs_of(upstream.node) | cls.tiny_inputs(upstream.store)

    @pytest.fixture(scope="class")
    @classmethod
    def real(cls, upstream: Upstream, spec: StageSpec, inputs: dict[str, Any], tiny: dict[str, Any]) -> Result:
        """One tiny real run, shared by the tests that look at it."""
        return invoke(spec, upstream.store, inputs, parameters=tiny)

    @classmethod
    def tiny_inputs(cls, store: Store) -> dict[str, Any]:
        """Inputs that a stub upstream cannot give (capture-ingest overrides this: it needs real pictures)."""
        path = cls.folder / "tests" / "tiny_source"
        if not path.is_dir():
            return {}
        folder = store.private_folder()
        for file in sorted(path.rglob("*")):
            if file.is_file():
                target = folder / "raw" / file.relative_to(path)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(file.read_bytes())
        return {"source": store.put(folder, "source", Source(name=path.name, kind="folder"))}

    def test_every_stage_folder_has_the_same_shape(self, spec: StageSpec) -> None:
        package = self.folder / "src" / "inpaint3d" / "stages" / self.folder.name
        for file in ("__main__.py", "config.py", "run.py", "stub.py"):
            assert (package / file).is_file(), file
        for file in ("stage.yaml", "README.md", "pyproject.toml", "tests/test_contract.py", "tests/test_run.py"):
            assert (self.folder / file).is_file(), file
        assert list_tests(self.folder / "tests" / "test_run.py"), "test_run.py tests nothing"
        assert spec.metadata.name == self.folder.name.replace("_", "-")
        assert spec.spec.module == f"inpaint3d.stages.{self.folder.name}"

    def test_real_run_writes_the_declared_ports(self, upstream: Upstream, spec: StageSpec, real: Result) -> None:
        assert real.code == 0, real.error + real.stderr
        required = {p for p, d in spec.spec.outputs.items() if not d.optional}
        assert required <= set(real.outputs) <= set(spec.spec.outputs)
        for port, digest in real.outputs.items():
            manifest = upstream.store.manifest(digest)
            assert manifest.schema_id == spec.spec.outputs[port].schema_id
            assert upstream.store.find_damage(digest) is None

    def test_stub_is_valid_without_a_tensor_library(self, upstream: Upstream, spec: StageSpec) -> None:
        result = invoke(spec, upstream.store, upstream.inputs_of(upstream.node), stub=True)
        assert result.code == 0, result.error + result.stderr
        assert {p for p, d in spec.spec.outputs.items() if not d.optional} <= set(result.outputs)
        code = (
            f"import sys, {spec.spec.module}.stub, {spec.spec.module}.config;"
            f"sys.exit(any(m in sys.modules for m in {TENSOR_LIBRARIES}))"
        )
        assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

    def test_downstream_accepts_what_it_writes(self, upstream: Upstream, real: Result) -> None:
        """Who reads a real output opens it at its own ports, and the first of them runs its stub on it."""
        assert real.code == 0, real.error + real.stderr
        for digest in real.outputs.values():
            name = split_schema(upstream.store.manifest(digest).schema_id)[0]
            upstream.store.open(digest, SCHEMAS[name][1])
        readers = upstream.readers_of(upstream.node, real.outputs)
        if not readers:  # the last of a pipeline: the orchestrator reads it, by that same model
            return
        upstream.take(upstream.node, real)
        upstream.prepare(first := next(iter(readers)))
        result = invoke(upstream.pipeline.stages[first], upstream.store, upstream.inputs_of(first), stub=True)
        assert result.code == 0, f"{first} does not accept it: {result.error}\n{result.stderr}"
        for reader, ports in readers.items():
            inputs = Inputs(upstream.store, upstream.pipeline.stages[reader], upstream.inputs_of(reader))
            for port in ports:
                schema = upstream.pipeline.stages[reader].spec.inputs[port].schema_range
                assert inputs.many(port, SCHEMAS[split_schema(schema)[0]][1]), f"{reader}.{port} got nothing"

    def test_missing_input_is_bad_input_and_commits_nothing(self, upstream: Upstream, spec: StageSpec) -> None:
        before = list_committed_keys(upstream.store)
        ports = upstream.inputs_of(upstream.node)
        broken: dict[str, Any] = {p: ([DAMAGED] if isinstance(d, list) else DAMAGED) for p, d in ports.items()}
        result = invoke(spec, upstream.store, broken)
        assert result.code == 3, result.stderr
        assert "is not in the store" in result.error
        assert list_committed_keys(upstream.store) == before

    def test_unknown_parameter_is_a_configuration_error(
        self, upstream: Upstream, spec: StageSpec, inputs: dict[str, Any]
    ) -> None:
        before = list_committed_keys(upstream.store)
        result = invoke(spec, upstream.store, inputs, parameters={"no_such_parameter": 1})
        assert result.code == 2, result.stderr
        assert "no_such_parameter" in result.error
        assert list_committed_keys(upstream.store) == before

    def test_same_input_gives_the_same_digest(
        self, upstream: Upstream, spec: StageSpec, inputs: dict[str, Any], tiny: dict[str, Any], real: Result
    ) -> None:
        again = FolderStore(upstream.store.root.parent / f"{upstream.store.root.name}-again")
        (again.root / "objects").rmdir()
        (again.root / "objects").symlink_to(upstream.store.root / "objects")
        repeated = invoke(spec, again, inputs, parameters=tiny)
        assert repeated.code == 0, repeated.error
        if spec.spec.determinism == "exact":
            assert repeated.outputs == real.outputs
        else:
            assert set(repeated.outputs) == set(real.outputs)
            assert len(spec.spec.determinism.tolerance) > 20

    def test_sigterm_is_honoured(
        self, upstream: Upstream, spec: StageSpec, inputs: dict[str, Any], tiny: dict[str, Any]
    ) -> None:
        """Stopped as soon as it starts to work: exit 143 (or 0, where it was already done), nothing half-committed."""
        before = list_committed_keys(upstream.store)
        line = build_command(spec, upstream.store, Invocation(inputs=inputs, threads=1, parameters=tiny, seed=1))
        process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first, "a stage tells of its progress"
        process.send_signal(signal.SIGTERM)
        stopped_at = time.monotonic()
        process.communicate()
        assert time.monotonic() - stopped_at < 30
        assert process.returncode in (143, 0)
        committed = list_committed_keys(upstream.store) - before
        assert len(committed) == (1 if process.returncode == 0 else 0)

    def test_describe_prints_the_spec(self, spec: StageSpec) -> None:
        line = [sys.executable, "-m", spec.spec.module, "describe"]
        out = subprocess.run(line, capture_output=True, text=True, check=True, env=dict(os.environ)).stdout
        assert StageSpec.model_validate_json(out) == spec


def stage_contract(test_file: str) -> type[StageContract]:
    """The suite for the stage whose `tests/test_contract.py` this is."""
    return type("TestContract", (StageContract,), {"folder": Path(test_file).resolve().parents[1]})
