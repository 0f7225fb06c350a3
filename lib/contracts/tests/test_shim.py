"""What the shim makes of a stage that fails: exit code, message, and what the next run finds. Real processes."""

import os
from textwrap import dedent

import pytest

from inpaint3d.contracts.kit.code import IMAGE_DIGEST
from inpaint3d.contracts.kit.upstream import invoke, store_externals
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import FolderStore

STAGE = """\
    apiVersion: inpaint3d/v1
    kind: Stage
    metadata: {name: toy, version: 0.1.0}
    spec:
      description: toy
      image: inpaint3d/toy
      module: inpaint3d.stages.toy
      inputs: {source: {schema: source@1}}
      outputs: {effect-plan: {schema: effect-plan@1.0}}
    """
CONFIG = """\
    from inpaint3d.contracts.models.base import Closed

    class Config(Closed):
        way: str = "well"
    """
MAIN = "from inpaint3d.contracts.kit.shim import serve\nserve('inpaint3d.stages.toy')\n"
RUN = """\
    import json
    from inpaint3d.contracts.errors import InterruptedRun
    from inpaint3d.contracts.models.artifacts import Effect, EffectPlan, Source

    def read_count(path):
        return json.loads(path.read_text())["count"]

    def run(config, inputs, outputs, ctx):
        source = inputs.one("source", Source)
        ctx.record("curve", step=1, loss=0.5)
        if config.way == "doubtful":
            ctx.doubt("3 dB; take more photos")
        if config.way == "bug":
            Effect(name="exposure")
        if config.way == "bad data":
            read_count(source.path("raw/readme.txt"))
        if config.way == "full":
            (outputs.folder("effect-plan") / "half").write_bytes(bytes(100))
            raise RuntimeError("IoError: No space left on device (os error 28)")
        kept = ctx.work / "kept.json"
        if config.way == "resume" and not kept.exists():
            kept.write_text('{"count": 1}')
            raise InterruptedRun("stopped")
        count = read_count(kept) if kept.exists() else 0
        effect = Effect(name="exposure", state="off", evidence={"count": count}, reason="still")
        outputs.write("effect-plan", EffectPlan(effects=(effect,)))
    """


@pytest.fixture
def stage(tmp_path, monkeypatch):
    folder = tmp_path / "toy"
    package = folder / "src" / "inpaint3d" / "stages" / "toy"
    package.mkdir(parents=True)
    (folder / "stage.yaml").write_text(dedent(STAGE))
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text(MAIN)
    (package / "config.py").write_text(dedent(CONFIG))
    (package / "run.py").write_text(dedent(RUN))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(folder / "src")]))
    monkeypatch.setenv(IMAGE_DIGEST, "sha256:" + "a" * 64)
    store = FolderStore(tmp_path / "store")
    inputs = {"source": store_externals(store)["external.capture"]}
    spec = load_stage(folder / "stage.yaml")
    return store, lambda way, **asked: invoke(spec, store, inputs, parameters={"way": way}, **asked)


@pytest.mark.parametrize(
    ("way", "code", "says"),
    [
        ("bug", 1, "ValidationError"),
        ("bad data", 3, "source: readme.txt cannot be read (JSONDecodeError"),
        ("full", 5, "no space left"),
        ("well", 0, ""),
    ],
)
def test_errors_of_a_stage_are_never_blamed_on_its_invocation(stage, way, code, says):
    store, run = stage
    before = store.names("tmp")
    result = run(way)
    assert (result.code, says in result.error) == (code, True), result.stderr
    assert "invocation.json" not in result.error
    assert len(list(store.records())) == (code == 0)
    if code:
        assert "Traceback" in result.stderr, "whoever looks for a bug in the reader finds it in the log"
    assert len(store.names("tmp")) == len(before) + 1, "the invocation's; what was half written gave its space back"


def test_a_doubtful_result_is_kept_and_stops_until_somebody_insists(stage):
    store, run = stage
    for _ in range(2):  # the second time it is found
        result = run("doubtful", accept_doubtful=False)
        assert result.code == 6
        assert result.error == "3 dB; take more photos. The result is kept: --accept-doubtful goes on with it"
    (record,) = store.records()
    accepted = run("doubtful")
    assert (accepted.code, accepted.outputs) == (0, record.outputs)
    assert accepted.events[-1]["key"] == record.key


@pytest.mark.parametrize("junk", [b"", b"{", b"[]", b'{"count": [}', b"\xff\xfe", b"{}"])
def test_a_stage_that_cannot_read_what_it_left_starts_anew(stage, junk):
    store, run = stage
    assert run("resume").code == 143
    (work,) = [p for p in (store.root / "work").iterdir() if p.is_dir()]
    assert run("resume").code == 0, "as it is, it goes on"
    (key,) = store.names("keys")
    store.remove(f"keys/{key}")
    work.mkdir()
    (work / "kept.json").write_bytes(junk)
    result = run("resume")
    assert result.code == 143, "it starts anew, and this one is stopped at its start"
    assert "starts anew" in str(result.events)
    assert run("resume").code == 0


@pytest.mark.parametrize(
    "junk", [b"7\n", b"null\n", b'{"series": 3}\n', b"\xff\n", b'{"a": NaN}\n', b'{"series": "a", "step": []}\n']
)
def test_junk_among_what_a_run_left_is_passed_over(stage, junk):
    store, run = stage
    assert run("resume").code == 143
    (work,) = [p for p in (store.root / "work").iterdir() if p.is_dir()]
    with (work / "series.jsonl").open("ab") as file:
        file.write(junk)
    (work / "clock.json").write_bytes(junk)
    assert run("resume").code == 0
    (record,) = store.records()
    assert [row["loss"] for row in record.timings["series"]["curve"]] == [0.5]
    assert record.timings["wall_s"] >= 0
