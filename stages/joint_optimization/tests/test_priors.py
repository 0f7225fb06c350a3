"""Other people's priors in the stage itself: tiny diffusers pipelines, as the orchestrator would take them in."""

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.context import Inputs
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import DiffusersPipeline, RadianceFieldArtifact
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.diffusion.loading import load_denoiser
from inpaint3d.diffusion.pipelines import PipelinePrior
from inpaint3d.scene.windows import draw_window
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.guidance import DatasetGuide, PriorGuide
from inpaint3d.stages.joint_optimization.run import pose
from inpaint3d.stages.joint_optimization.schedule import TimestepRange
from tests.tiny_pipelines import latent_pipeline, pixel_pipeline

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")

MODULE = "inpaint3d.stages.joint_optimization"
TINY = yaml.safe_load((Path(__file__).parent / "tiny.yaml").read_text()) | {"steps": 3, "terms_every": 1}
COMMON = {"warmup_steps": 0, "distill_every": 1, "weight_warmup": 0}
OWN = {
    "sdi": {"inversion_steps": 2}, "ism": {"inversion_steps": 2}, "denoised-target": {"denoise_steps": 2},
    "dataset-update": {"denoise_steps": 2, "update_every": 2},
}  # fmt: skip
STAGE = Path(__file__).parents[1] / "stage.yaml"
KINDS = ("9 channels", "4 channels", "pixels")
# nfsd compares two conditions, and only a network of 9 channels is shown any.
WITHOUT_CONDITION = [("nfsd", "4 channels"), ("nfsd", "pixels")]
DISTILLING = ("sds", "nfsd", "sdi", "ism", "denoised-target", "dataset-update")
USABLE = [(e, k) for e in DISTILLING for k in KINDS if (e, k) not in WITHOUT_CONDITION]

Wired = Callable[..., dict[str, Any]]


def put_pipeline(store: Store, kind: str, scratch: Path) -> Digest:
    pipeline = pixel_pipeline() if kind == "pixels" else latent_pipeline(scratch, int(kind[0]))
    folder = store.private_folder()
    pipeline.save_pretrained(folder / "pipeline")
    return store.put(folder, "diffusers-pipeline", DiffusersPipeline(kind=type(pipeline).__name__))


def parameters_of(estimator: str, **changes: Any) -> dict[str, Any]:
    return TINY | {"estimator": {"name": estimator} | COMMON | OWN.get(estimator, {}) | changes}


def optimise(store: Store, inputs: dict[str, Any], estimator: str) -> Artifact[RadianceFieldArtifact]:
    invocation = Invocation(inputs=inputs, parameters=parameters_of(estimator), threads=1)
    record = execute(MODULE, store, invocation, io.StringIO())
    return store.open(record.outputs["radiance-field"], RadianceFieldArtifact)


@pytest.mark.parametrize(("estimator", "kind"), USABLE)
def test_an_estimator_moves_the_field_by_a_pipeline(
    store: Store, inputs: Wired, tmp_path: Path, estimator: str, kind: str
) -> None:
    wired = inputs() | {"diffusers-pipeline": put_pipeline(store, kind, tmp_path)}
    result = optimise(store, wired, estimator)
    with result.path("terms.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["push"]) > 0 for row in rows] == [True] * 3
    assert all(0 < float(row["gradient_distillation"]) < float("inf") for row in rows)
    assert not result.metadata.non_finite
    # Another prior, another field: the trained one that is wired too was not what was asked.
    del wired["diffusers-pipeline"]
    assert optimise(store, wired, estimator).digest != result.digest


@pytest.mark.parametrize(("estimator", "kind"), USABLE)
def test_the_gradient_is_that_of_the_hole_alone(
    store: Store, inputs: Wired, tmp_path: Path, estimator: str, kind: str
) -> None:
    wired = inputs() | {"diffusers-pipeline": put_pipeline(store, kind, tmp_path)}
    config = Config.model_validate(parameters_of(estimator, guidance=2.0, prompt="chair"))
    problem, _ = pose(config, Inputs(store, load_stage(STAGE), wired), 0, "cpu")
    guide, view = problem.guide, problem.to_fill[0]
    assert isinstance(guide, PriorGuide | DatasetGuide)
    assert guide.size == 32
    window = draw_window(view.hole, view.known, 0, size=32, span=0.7, min_known=0.2, rng=None)
    assert window is not None
    hole = torch.from_numpy(window.sample(view.hole))
    patch = torch.rand(32, 32, 3, generator=torch.Generator().manual_seed(1))
    gradient, t = guide.gradient(
        patch, hole, window, TimestepRange(0.4, 0.6, floored=False), torch.Generator().manual_seed(2)
    )
    assert gradient.isfinite().all()
    assert gradient[hole].any()
    assert not gradient[~hole].any()
    assert 0.4 <= t <= 0.6


def test_what_a_pipeline_is_told_is_a_parameter(store: Store, inputs: Wired, tmp_path: Path) -> None:
    wired = Inputs(store, load_stage(STAGE), inputs() | {"diffusers-pipeline": put_pipeline(store, KINDS[0], tmp_path)})
    told, untold = (load_denoiser(wired, asker="a test", prompt=prompt, device="cpu") for prompt in ("chair", ""))
    assert isinstance(told, PipelinePrior)
    assert isinstance(untold, PipelinePrior)
    assert told.texts is not None
    assert untold.texts is not None
    assert torch.equal(told.texts[0], untold.texts[0])
    assert not torch.equal(told.texts[1], untold.texts[1])


@pytest.mark.parametrize(("estimator", "kind"), WITHOUT_CONDITION)
def test_an_estimator_that_compares_conditions_needs_one(
    store: Store, inputs: Wired, tmp_path: Path, estimator: str, kind: str
) -> None:
    wired = inputs() | {"diffusers-pipeline": put_pipeline(store, kind, tmp_path)}
    with pytest.raises(ConfigurationError, match=r"'nfsd' compares two conditions.*Pipeline at.*set another"):
        optimise(store, wired, estimator)


def test_a_copy_of_a_pipeline_does_not_learn(store: Store, inputs: Wired, tmp_path: Path) -> None:
    wired = inputs() | {"diffusers-pipeline": put_pipeline(store, "9 channels", tmp_path)}
    with pytest.raises(ConfigurationError, match=r"'vsd' teaches .* StableDiffusionInpaintPipeline .* or give no pipe"):
        optimise(store, wired, "vsd")


def test_a_pipeline_that_cannot_be_asked_is_bad_input(store: Store, inputs: Wired) -> None:
    folder = store.private_folder()
    (folder / "pipeline").mkdir()
    (folder / "pipeline" / "model_index.json").write_text('{"_class_name": "DDPMPipeline"}')
    broken = store.put(folder, "diffusers-pipeline", DiffusersPipeline(kind="DDPMPipeline"))
    with pytest.raises(BadInputError, match=r"diffusers-pipeline sha256:.* is no folder of a diffusers pipeline"):
        optimise(store, inputs() | {"diffusers-pipeline": broken}, "sds")
