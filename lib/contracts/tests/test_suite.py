"""The contract suite can fail: a pipeline of two small stages, the first of which does its work badly."""

import os
from textwrap import dedent

import pytest

from inpaint3d.contracts.kit.code import IMAGE_DIGEST
from inpaint3d.contracts.kit.suite import list_tests, stage_contract
from inpaint3d.contracts.kit.upstream import Upstream, invoke
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore

STAGE = """\
    apiVersion: inpaint3d/v1
    kind: Stage
    metadata: {{name: {name}, version: 0.1.0}}
    spec:
      description: {name}
      image: inpaint3d/{name}
      module: inpaint3d.stages.{name}
      inputs: {{{input}}}
      outputs: {{effect-plan: {{schema: effect-plan@1.0}}}}
    """
PIPELINE = """\
    apiVersion: inpaint3d/v1
    kind: Pipeline
    metadata: {name: two}
    spec:
      externals: {capture: {schema: source@1}}
      stages:
        - {name: writer, stage: stages/writer, inputs: {source: external.capture}}
        - {name: reader, stage: stages/reader, inputs: {effect-plan: writer.effect-plan}}
    """
CONFIG = """\
    from inpaint3d.contracts.models.base import Closed

    class Config(Closed):
        effects: int = 1
    """
WRITER = """\
    from inpaint3d.contracts.models.artifacts import Effect, EffectPlan

    def {name}(config, inputs, outputs, ctx):
        effect = Effect(name="exposure", state="off", evidence={{}}, reason="still")
        outputs.write("effect-plan", EffectPlan(effects=(effect,) * config.effects))
        ctx.progress(1, 1)
    """
READER = """\
    from inpaint3d.contracts.errors import ArtifactError
    from inpaint3d.contracts.models.artifacts import EffectPlan

    def {name}(config, inputs, outputs, ctx):
        plan = inputs.one("effect-plan", EffectPlan).metadata
        if not plan.effects:
            raise ArtifactError("a plan without effects; run writer again")
        outputs.write("effect-plan", plan)
        ctx.progress(1, 1)
    """
MAIN = "from inpaint3d.contracts.kit.shim import serve\nserve('inpaint3d.stages.{name}')\n"


@pytest.fixture
def repository(tmp_path, monkeypatch):
    paths = []
    for name, source, body in (("writer", "source: {schema: source@1}", WRITER),
                               ("reader", "effect-plan: {schema: effect-plan@1}", READER)):  # fmt: skip
        folder = tmp_path / "stages" / name
        package = folder / "src" / "inpaint3d" / "stages" / name
        package.mkdir(parents=True)
        (folder / "tests").mkdir()
        (folder / "stage.yaml").write_text(dedent(STAGE).format(name=name, input=source))
        (package / "__init__.py").touch()
        (package / "__main__.py").write_text(MAIN.format(name=name))
        (package / "config.py").write_text(dedent(CONFIG))
        for method in ("run", "stub"):
            (package / f"{method}.py").write_text(dedent(body).format(name=method))
        paths.append(str(folder / "src"))
    (tmp_path / "pipeline.yaml").write_text(dedent(PIPELINE))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    monkeypatch.setenv(IMAGE_DIGEST, "sha256:" + "a" * 64)  # the two are not installed
    return tmp_path


def check_downstream(repository, node, **parameters):
    """The suite's own test, on a real run with these parameters."""
    contract = stage_contract(str(repository / "stages" / node / "tests" / "test_contract.py"))()
    upstream = Upstream(Pipeline(repository / "pipeline.yaml"), node, FolderStore(repository / "store"))
    spec = upstream.pipeline.stages[node]
    real = invoke(spec, upstream.store, upstream.inputs_of(node), parameters=parameters)
    contract.test_downstream_accepts_what_it_writes(upstream, real)


def test_what_the_reader_accepts_passes(repository):
    check_downstream(repository, "writer", effects=2)


def test_what_the_last_stage_writes_passes(repository):
    check_downstream(repository, "reader")


def test_what_its_schema_allows_but_its_reader_refuses_fails(repository):
    with pytest.raises(AssertionError, match="reader does not accept it: a plan without effects"):
        check_downstream(repository, "writer", effects=0)


def test_a_run_that_failed_is_no_run_that_passes(repository):
    with pytest.raises(AssertionError, match="effects"):
        check_downstream(repository, "writer", effects="many")


@pytest.mark.parametrize(
    ("source", "tests"),
    [
        ("", []),
        ("def helper():\n    def test_inner(): ...\n", []),
        ("class Helper:\n    def test_a(self): ...\n", []),
        ("def test_a(): ...\n", ["test_a"]),
        ("class TestRun:\n    def test_b(self): ...\n    def build(self): ...\n", ["test_b"]),
    ],
)
def test_a_file_without_tests_is_known_from_one_with(tmp_path, source, tests):
    (tmp_path / "test_run.py").write_text(source)
    assert list_tests(tmp_path / "test_run.py") == tests


def test_a_stage_with_an_empty_test_run_fails(repository):
    folder = repository / "stages" / "writer"
    for name in ("README.md", "pyproject.toml", "tests/test_contract.py", "tests/test_run.py"):
        (folder / name).touch()
    contract = stage_contract(str(folder / "tests" / "test_contract.py"))()
    spec = Pipeline(repository / "pipeline.yaml").stages["writer"]
    with pytest.raises(AssertionError, match=r"test_run\.py tests nothing"):
        contract.test_every_stage_folder_has_the_same_shape(spec)
    (folder / "tests" / "test_run.py").write_text("def test_it(): ...\n")
    contract.test_every_stage_folder_has_the_same_shape(spec)
