"""Every stage that can use a GPU, run on a pretended one: a tensor that is not moved there fails."""

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.documents import load_yaml
from inpaint3d.contracts.models.pipeline import merge_parameters
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import FolderStore, Record, Store
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.stages.view_completion.example import fill_by_example
from tests.conftest import REPOSITORY
from tests.devices.pretended import pretend_cuda
from tests.room_artifacts import put_completed, put_masks, put_plan, put_posed, put_prior

STAGES = {path.parent.name: load_stage(path) for path in sorted((REPOSITORY / "stages").glob("*/stage.yaml"))}
ESTIMATORS: list[dict[str, Any]] = [
    {"name": "sds", "guidance": 2.0},
    {"name": "vsd"},
    {"name": "dataset-update", "update_every": 2},
    {"name": "features", "matching": "sliced", "patch_size": 16},
    {"name": "completed-views", "patch_size": 16},
]
pytestmark = pytest.mark.filterwarnings("ignore:CUDA is not available:UserWarning")


@dataclass(frozen=True)
class Bench:
    """The room's artifacts, by port, and a store to run stages on."""

    store: Store
    room: SyntheticScene
    wired: dict[str, Any]

    def run(self, stage: str, parameters: dict[str, Any] | None = None, **also: Any) -> Record:
        """A stage's tiny run on the pretended GPU."""
        spec = STAGES[stage]
        tiny, _ = load_yaml(REPOSITORY / "stages" / stage / "tests" / "tiny.yaml")
        wired = {port: digest for port, digest in (self.wired | also).items() if port in spec.spec.inputs}
        invocation = Invocation(
            inputs=wired, parameters=merge_parameters(tiny or {}, parameters or {}), threads=1, device="cuda"
        )
        with pytest.MonkeyPatch.context() as monkeypatch, pretend_cuda(monkeypatch):
            return execute(f"inpaint3d.stages.{stage}", self.store, invocation, io.StringIO())


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    store, room = FolderStore(tmp_path_factory.mktemp("store")), synthetic_scene(views=6)
    wired = {
        "posed-capture": put_posed(store, room, room.images),
        "effect-plan": put_plan(store, "view-dependence", "exposure", "contraction"),
        "mask-set": put_masks(store, room.names, room.object_masks),
        "completed-views": put_completed(store, room),
        "diffusion-prior": put_prior(store),
    }
    return Bench(store, room, wired)


@pytest.fixture(scope="module")
def field(bench: Bench) -> str:
    return bench.run("nerf_pretraining").outputs["radiance-field"]


def test_the_field_is_fitted_there(bench: Bench) -> None:
    faster = {"architecture": {"sampler": "density-grid", "density_cells": 8, "density_bins": 8}}
    record = bench.run("nerf_pretraining", faster | {"optimizer": {"sparse_adam": True}})
    assert record.components["device"] == "cuda"


def test_a_prior_is_trained_there(bench: Bench) -> None:
    """Judged before and after, from another one's weights."""
    bench.run("diffusion_training", {"steps": 2, "exam": 1}, **{"pretrained-prior": bench.wired["diffusion-prior"]})


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: e["name"])
def test_the_hole_is_filled_there(bench: Bench, field: str, estimator: dict[str, Any]) -> None:
    few = {"steps": 3, "terms_every": 2, "estimator": estimator | {"distill_every": 1}}
    untiny = {"start": "initial-field"}
    bench.run("joint_optimization", few | untiny, **{"initial-field": field})


@pytest.mark.parametrize("method", ["photo-completion", {"name": "prior-samples", "sample_steps": 2}], ids=str)
def test_views_are_completed_there(bench: Bench, field: str, method: Any) -> None:
    bench.run("view_completion", {"method": method}, **{"radiance-field": field})


def test_a_hole_is_filled_by_example_there(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.tile(bench.room.images[0], (2, 2, 1))
    hole = np.zeros(image.shape[:2], bool)
    hole[20:44, 30:60] = True
    here = fill_by_example(image, hole, ~hole, variety=0.5)[0]
    with pretend_cuda(monkeypatch):
        there = fill_by_example(image, hole, ~hole, variety=0.5, device="cuda")[0]
    np.testing.assert_array_equal(there, here)


def test_fields_are_evaluated_there(bench: Bench, field: str) -> None:
    bench.run("evaluation", **{"radiance-fields": [field]})


def test_the_scene_is_exported_there(bench: Bench, field: str) -> None:
    bench.run(
        "usd_export",
        {"render_longest_side": 24, "grid": 24, "texture_size": 128, "triangles": 200},
        inpainted=field,
        original=field,
    )


def test_every_stage_that_can_use_a_gpu_is_tried() -> None:
    tried = {
        "nerf-pretraining",
        "diffusion-training",
        "joint-optimization",
        "view-completion",
        "evaluation",
        "usd-export",
    }
    assert {s.metadata.name for s in STAGES.values() if s.spec.gpu != "none"} == tried
