import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from inpaint3d.contracts.errors import BadInputError, ConfigurationError, InterruptedRun
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import DiffusionPrior, PriorSpec, RadianceFieldArtifact
from inpaint3d.contracts.models.pipeline import merge_parameters
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.diffusion.io import save_prior
from inpaint3d.diffusion.loading import load_trained_prior
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.runtimes import OnnxNetwork, export_onnx
from inpaint3d.diffusion.unet import EfficientUNet
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.rendering import render_view
from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.curves import Curves
from inpaint3d.stages.joint_optimization.estimators import ESTIMATORS
from inpaint3d.stages.joint_optimization.run import run
from tests.room_artifacts import put_completed

MODULE = "inpaint3d.stages.joint_optimization"
STAGE = load_stage(Path(__file__).parents[1] / "stage.yaml")
TINY = yaml.safe_load((Path(__file__).parent / "tiny.yaml").read_text())

Wired = Callable[..., dict[str, Any]]


def optimise(store: Store, inputs: dict[str, Any], **parameters: Any) -> Artifact[RadianceFieldArtifact]:
    invocation = Invocation(inputs=inputs, parameters=merge_parameters(TINY, parameters), threads=1)
    record = execute(MODULE, store, invocation, io.StringIO())
    return store.open(record.outputs["radiance-field"], RadianceFieldArtifact)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_nothing_under_the_mask_reaches_the_field(
    store: Store, inputs: Wired, room: SyntheticScene, estimator: str
) -> None:
    """Repainting every masked pixel with a marker colour changes no byte."""
    own = {"dataset-update": {"update_every": 2}}
    few = {"steps": 5, "estimator": {"name": estimator} | own.get(estimator, {})}
    marked = np.where(room.object_masks[..., None], np.array([1.0, 0.0, 1.0], np.float32), room.images)
    assert (marked != room.images).any()
    completed = {"completed-views": put_completed(store, room)}
    clean = optimise(store, inputs() | completed, **few)
    marker = optimise(store, inputs(marked) | completed, **few)
    assert clean.digest == marker.digest
    # Something outside the mask does reach it: the test can see a difference.
    other = np.where(room.object_masks[..., None], room.images, 1 - room.images)
    assert optimise(store, inputs(other) | completed, **few).digest != clean.digest


def test_reconstruction_learns_what_is_known(store: Store, inputs: Wired, room: SyntheticScene) -> None:
    """It beats the mean colour on the known pixels of the view that it was not fitted to."""
    finer = TINY["architecture"] | {"levels": 5, "finest": 96, "log2_table": 14, "samples": 16}
    result = optimise(store, inputs(), estimator="none", steps=250, rays=512, architecture=finer)
    mean = room.images[~room.object_masks].mean(0)
    known = ~room.object_masks[2]
    baseline = psnr(np.broadcast_to(mean, room.images[2].shape), room.images[2], known)
    assert result.metadata.held_out_psnr is not None
    assert result.metadata.held_out_psnr > baseline + 1.0
    field = load_field(result.path("weights.safetensors"), result.metadata.spec)
    assert psnr(render_view(field, room.cameras[2])["rgb"], room.images[2], known) > baseline + 1.0


def test_the_learning_curve_and_the_terms_are_in_the_artifact(store: Store, inputs: Wired) -> None:
    result = optimise(store, inputs())
    curve = rows(result.path("learning_curve.csv"))
    assert [int(r["step"]) for r in curve] == [4, 8, 12]
    assert all(float(r["psnr"]) > 0 for r in curve)
    terms = rows(result.path("terms.csv"))
    assert [int(r["step"]) for r in terms] == [4, 8, 12]
    for row in terms:
        ratio = float(row["gradient_distillation"]) / float(row["gradient_reconstruction"])
        assert float(row["distillation_over_reconstruction"]) == pytest.approx(ratio, rel=1e-5)
        assert float(row["t_low"]) <= float(row["t"]) <= float(row["t_high"])
    # S6: two steps of reconstruction, then a rise over two of distillation: the fourth step stands half way.
    assert [float(r["weight"]) for r in terms] == [0.05, 0.1, 0.1]
    # S10: the specular share grows over the first half of twelve steps, and the fourth has step number 3.
    assert [float(r["specular_scale"]) for r in terms] == [0.5, 1.0, 1.0]


def test_the_push_of_the_prior_is_logged_where_not_every_step_distils(store: Store, inputs: Wired) -> None:
    result = optimise(store, inputs(), estimator={"distill_every": 2, "warmup_steps": 0}, steps=9)
    measured = [r["distillation_over_reconstruction"] for r in rows(result.path("terms.csv"))]
    assert len(measured) == 2
    assert all(measured)


def test_without_a_prior_no_distillation_is_logged(store: Store, inputs: Wired) -> None:
    wired = inputs()
    del wired["diffusion-prior"]
    result = optimise(store, wired, estimator="none")
    assert result.metadata.label == "masked-reconstruction"
    assert {r["gradient_distillation"] for r in rows(result.path("terms.csv"))} == {""}
    assert result.metadata.decisions["diffuse-only-start"] == "off: no prior is used"


def test_an_estimator_without_a_prior_is_a_configuration_error(store: Store, inputs: Wired) -> None:
    wired = inputs()
    del wired["diffusion-prior"]
    with pytest.raises(ConfigurationError, match="estimator 'sds' asks a prior, and nothing is wired to its inputs"):
        optimise(store, wired)


COMPLETED = {"name": "completed-views", "patch_size": 16, "warmup_steps": 0}


def test_completed_views_are_fitted(store: Store, inputs: Wired, room: SyntheticScene) -> None:
    """The hole takes the colour that the completed pictures have there, by rays alone and with LPIPS on top."""
    with pytest.raises(ConfigurationError, match="nothing is wired to the input completed-views"):
        optimise(store, inputs(), estimator="completed-views")
    magenta = np.where(room.object_masks[..., None], np.array([1.0, 0.0, 1.0], np.float32), room.images)
    wired = inputs() | {"completed-views": put_completed(store, room, pictures=magenta)}

    def error(estimator: Any) -> float:
        result = optimise(store, wired, estimator=estimator, steps=100, rays=256)
        field = load_field(result.path("weights.safetensors"), result.metadata.spec)
        shown, hole = render_view(field, room.cameras[0])["rgb"], room.object_masks[0]
        return float(np.abs(shown - magenta[0])[hole].mean())

    nothing, rays, both = (error(e) for e in ("none", COMPLETED | {"weight": 0.0}, COMPLETED))
    assert rays < 0.5 * nothing
    assert both < 0.5 * nothing


def test_what_completion_says_is_in_the_artifact(store: Store, inputs: Wired, room: SyntheticScene) -> None:
    wired = inputs() | {"completed-views": put_completed(store, room)}
    result = optimise(store, wired, estimator=COMPLETED, steps=3)
    assert result.metadata.label == "joint-photo-completion"
    assert result.metadata.decisions["hole"] == "the empty room"
    assert result.metadata.decisions["cost"] == "no UNet evaluation"
    sampled = inputs() | {"completed-views": put_completed(store, room, method="prior-samples")}
    windows = COMPLETED | {"windows": "whole-hole", "span": 0.75, "filled_share": 0.0}
    assert optimise(store, sampled, estimator=windows, steps=3).metadata.label == "inpaint-then-nerf"


def test_completed_views_of_another_capture_are_bad_input(store: Store, inputs: Wired, room: SyntheticScene) -> None:
    wired = inputs() | {"completed-views": put_completed(store, room, skip=1)}
    with pytest.raises(BadInputError, match="have no view view_000; re-run view-completion"):
        optimise(store, wired, estimator=COMPLETED)


# What the exporter uses of torch and onnxscript is old to torch itself.
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_a_prior_is_asked_in_the_runtime_that_it_names_unless_a_copy_of_it_learns(store: Store) -> None:
    folder = store.private_folder()
    prior = InpaintingPrior(PriorSpec(size=16, width=8, multipliers=(1,), blocks=(1,), attention=(False,)), seed=0)
    save_prior(folder / "weights.safetensors", prior)
    export_onnx(folder / "network.onnx", prior.eval())
    (folder / "training_curve.csv").write_text("step,loss,held_out_loss\n")
    metadata = DiffusionPrior(
        spec=prior.spec, steps=0, seed=0, trained_on="nothing", onnx="network.onnx", runtime="onnxruntime"
    )
    digest = store.put(folder, "diffusion-prior", metadata)
    wired = Inputs(store, STAGE, {"diffusion-prior": digest})
    for trainable, network in ((False, OnnxNetwork), (True, EfficientUNet)):
        prior = load_trained_prior(wired, asker="a test", device="cpu", trainable=trainable)
        assert isinstance(prior.network, network)
    prior = load_trained_prior(wired, asker="a test", device="cuda", trainable=False)
    assert isinstance(prior.network, EfficientUNet)
    assert [name for name, kind in ESTIMATORS.items() if getattr(kind, "trains_copy", False)] == ["vsd"]


def test_a_view_without_mask_is_bad_input(store: Store, inputs: Wired) -> None:
    wired = inputs(masked=5)
    with pytest.raises(BadInputError, match="view_005"):
        optimise(store, wired)


def test_stopping_early_shows_in_no_step_before(store: Store, inputs: Wired) -> None:
    """S11: the schedules run over S steps, however many of them are done; only windows and weights may end earlier."""
    scheduled = {"schedule_steps": 24, "span_last": 0.75, "t_min": 0.2}
    fixed = {"estimator": scheduled, "optimizer": {"learning_rate_steps": 24}, "terms_every": 1}
    early, late = (optimise(store, inputs(), steps=steps, **fixed) for steps in (4, 8))
    first, second = (rows(artifact.path("terms.csv")) for artifact in (early, late))
    assert len(first) == 4
    assert first == second[:4]
    # Counted over its own steps, a short run would anneal faster: the row would not be the paper's.
    own = optimise(store, inputs(), **(fixed | {"estimator": scheduled | {"schedule_steps": None}, "steps": 4}))
    assert rows(own.path("terms.csv"))[3]["t_high"] != first[3]["t_high"]


def test_every_term_of_a_step_has_its_columns(store: Store, inputs: Wired) -> None:
    """What is descended is what is written: a term that has no column is an error, not a gap."""
    terms = rows(optimise(store, inputs(), steps=4).path("terms.csv"))
    assert all(float(row["loss_line_of_sight"]) > 0 and float(row["gradient_line_of_sight"]) > 0 for row in terms)
    with pytest.raises(ValueError, match="no column for loss_sight"):
        Curves().add_terms(1, {"sight": 0.1}, {})


def test_the_cost_of_the_estimator_is_in_the_artifact(store: Store, inputs: Wired) -> None:
    result = optimise(store, inputs(), steps=3, estimator={"name": "ism", "guidance": 2.0, "inversion_steps": 3})
    assert result.metadata.decisions["cost"] == "6 UNet evaluations a distilled step"


def test_an_initial_field_goes_on_where_it_was(store: Store, inputs: Wired) -> None:
    """Its architecture is kept, and distillation starts at once (S7)."""
    first = optimise(store, inputs(), estimator="none")
    second = optimise(
        store, inputs() | {"initial-field": first.digest}, steps=3, terms_every=1, architecture={"levels": 2}
    )
    assert second.metadata.spec == first.metadata.spec
    assert [r["t"] != "" for r in rows(second.path("terms.csv"))] == [True, True, True]
    assert "hole" in second.metadata.decisions
    whole = optimise(store, inputs() | {"initial-field": first.digest}, steps=3, estimator={"hole": "as-masked"})
    assert "hole" not in whole.metadata.decisions
    without = optimise(store, inputs() | {"initial-field": first.digest}, estimator="none", steps=3)
    assert without.metadata.label == "continued-reconstruction"


def test_a_fresh_start_forgets_the_initial_field(store: Store, inputs: Wired) -> None:
    """As in the paper: one optimisation from nothing."""
    first = optimise(store, inputs(), estimator="none")
    fresh = optimise(store, inputs() | {"initial-field": first.digest}, start="fresh")
    assert fresh.digest == optimise(store, inputs()).digest


def test_effects_that_are_off_are_absent(store: Store, inputs: Wired) -> None:
    flat = optimise(store, inputs(plan=()), steps=2)
    assert flat.metadata.spec.view_layers == 0
    assert not flat.metadata.spec.contraction
    assert flat.metadata.decisions["diffuse-only-start"] == "off: the field has no view-dependent colour"
    full = optimise(store, inputs(plan=("contraction", "exposure", "view-dependence")), steps=2)
    assert full.metadata.spec.contraction
    assert full.metadata.spec.glo_views == 5
    assert full.metadata.decisions["diffuse-only-start"].startswith("on: ")


class _Stops(Context):
    """A context that is told to stop at a given step, as SIGTERM would."""

    def __init__(self, work: Path, stop_at: int | None) -> None:
        super().__init__(seed=0, device="cpu", threads=1, work=work, emit=lambda event, **values: None)
        self.stop_at = stop_at

    def progress(self, done: float, total: float, message: str = "", **figures: float) -> None:
        self.stopping = self.stopping or (message == "optimising" and done == self.stop_at)
        super().progress(done, total, message, **figures)


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"estimator": "vsd"},
        {"estimator": {"name": "dataset-update", "update_every": 2}},
        {"estimator": COMPLETED},
        pytest.param({"ranks": 2}, marks=pytest.mark.slow),
    ],
)
def test_stopped_and_resumed_is_the_run_without_the_stop(
    store: Store, inputs: Wired, room: SyntheticScene, tmp_path: Path, parameters: dict[str, Any]
) -> None:
    """What vsd's copy learnt and the pictures of dataset-update are in the checkpoint too, and all ranks stop alike."""
    config, wired = Config.model_validate(merge_parameters(TINY, parameters)), inputs()
    wired["completed-views"] = put_completed(store, room)

    def artifact(work: Path, *stops: int | None) -> str:
        for stop in stops:
            outputs = Outputs(store, STAGE)
            ctx = _Stops(work, stop)
            if stop is None:
                run(config, Inputs(store, STAGE, wired), outputs, ctx)
                return outputs.store_all()["radiance-field"]
            with pytest.raises(InterruptedRun):
                run(config, Inputs(store, STAGE, wired), outputs, ctx)
        raise AssertionError("the last run must go to its end")

    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    whole = artifact(tmp_path / "a", None)
    assert artifact(tmp_path / "b", 3, 8, None) == whole
