"""Results of a run in Python and in a notebook."""

import subprocess
import sys

import pytest

import inpaint3d.client
from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import EffectPlan, Evaluation, PictureStrip
from inpaint3d.contracts.models.report import Machine, NodeRun, RunRecord
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.history import History


@pytest.fixture
def run(tmp_path):
    """A run with an evaluation of one picture, and a plan."""
    store = FolderStore(tmp_path)
    folder = store.private_folder()
    (folder / "pictures").mkdir()
    (folder / "pictures" / "a.png").write_bytes(b"a picture")
    (folder / "per_view.csv").write_text("view")
    strip = PictureStrip(view="<v>", file="pictures/a.png", captions=("before",))
    outputs = {
        "evaluation": store.put(folder, "evaluation", Evaluation(protocols=(), contact=strip)),
        "effect-plan": store.put(store.private_folder(), "effect-plan", EffectPlan(effects=())),
    }
    node = NodeRun(node="evaluation", status="done", reason="", outputs=outputs, wall_s=3.0)
    machine = Machine(processor="P", cores=1, memory_bytes=1, python="3.12")
    record = RunRecord(
        id="000001-a", name="kitchen", pipeline="p", preset=None, externals={}, status="done",
        started="2026-01-01T00:00:00", machine=machine, nodes=(node,),
    )  # fmt: skip
    History(store).save(record)
    return inpaint3d.client.open("kitchen", str(tmp_path))


def test_artifacts_are_typed_and_their_files_are_found(run):
    evaluation = run["evaluation.evaluation"]
    assert isinstance(evaluation.metadata, Evaluation)
    assert evaluation.path("pictures/a.png").read_bytes() == b"a picture"
    assert isinstance(run["evaluation.effect-plan"].metadata, EffectPlan)
    assert (run.name, run.status, len(run.artifacts)) == ("kitchen", "done", 2)


def test_what_there_is_not_is_said_with_what_there_is(run, tmp_path):
    with pytest.raises(ConfigurationError, match="has no usd; there are evaluation"):
        run["usd"]
    with pytest.raises(ConfigurationError, match="has several evaluation"):
        run["evaluation"]
    with pytest.raises(ConfigurationError, match="no file b"):
        run["evaluation.evaluation"].path("b")
    with pytest.raises(ConfigurationError, match="no run is called hall"):
        inpaint3d.client.open("hall", str(tmp_path))


def test_a_notebook_shows_them(run):
    assert "<td>evaluation</td><td>done</td><td>3.0</td>" in run._repr_html_()
    shown = run["evaluation.evaluation"]._repr_html_()
    assert "data:image/png;base64," in shown
    assert "&lt;v&gt;" in shown
    assert repr(run) == "<run kitchen: done, 2 artifacts>"


def test_it_takes_no_tensor_library():
    code = "import sys, inpaint3d.client; sys.exit(','.join(m for m in ('numpy', 'torch') if m in sys.modules) or 0)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
