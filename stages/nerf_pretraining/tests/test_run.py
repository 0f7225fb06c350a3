"""The whole stage on the synthetic room: real artifacts, real store, real shim."""

import csv
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open

from inpaint3d.contracts.errors import BadInputError, ConfigurationError, InterruptedRun
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import (
    Effect,
    EffectPlan,
    IgnoredFrame,
    LensModel,
    PosedCapture,
    RadianceFieldArtifact,
    Registration,
)
from inpaint3d.contracts.models.canonical import file_digest
from inpaint3d.contracts.store import Artifact, FolderStore, Record, Store
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.line_of_sight import SightLines
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.capture_io import load_points, load_posed, write_points, write_view
from inpaint3d.scene.map_io import read_exr
from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.stages.nerf_pretraining.config import Config
from inpaint3d.stages.nerf_pretraining.fit import Known, fit

TEST_VIEWS = (3, 7, 11)
SMALL: dict[str, Any] = {
    "architecture": {
        "levels": 6, "finest": 128, "log2_table": 14, "samples": 16, "proposal_samples": [24], "proposal_levels": 4,
        "proposal_finest": 64, "proposal_log2_table": 12, "density_width": 32, "view_width": 16, "view_layers": 1,
    },
    "steps": 500, "rays": 256, "ramp_steps": 0, "score_every": 250, "score_side": 24, "view_side": 48,
}  # fmt: skip
TINY = SMALL | {"steps": 8, "rays": 64, "first_rays": 32, "ramp_steps": 4, "score_every": 3, "view_side": 8}


@pytest.fixture(scope="module")
def scene() -> SyntheticScene:
    return synthetic_scene(views=16)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return FolderStore(tmp_path / "store")


def posed(store: Store, scene: SyntheticScene, *, test: tuple[int, ...] = TEST_VIEWS) -> str:
    folder = store.private_folder()
    frames = tuple(
        write_view(folder, name, image, camera, split="test" if i in test else "train")
        for i, (name, image, camera) in enumerate(zip(scene.names, scene.images, scene.cameras, strict=True))
    )
    write_points(folder / "points.safetensors", scene.points)
    registration = Registration(
        source="known",
        given=10,
        registered=10,
        mean_reprojection_error_px=0,
        points=9,
        median_triangulation_angle_deg=9,
    )
    metadata = PosedCapture(
        frames=frames, ordered=True, lens=LensModel(model="PINHOLE", params=(), evidence="exact"),
        registration=registration, source_from_normalised_scale=1, up_evidence="exact", centre_depth=0.85,
        source_from_normalised=((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0)),
    )  # fmt: skip
    return store.put(folder, "posed-capture", metadata)


def plan(store: Store, *on: str) -> str:
    effects = tuple(
        Effect(name=name, state="on" if name in on else "off", evidence={}, reason="test")
        for name in ("contraction", "exposure", "view-dependence")
    )
    return store.put(store.private_folder(), "effect-plan", EffectPlan(effects=effects))


def run(store: Store, inputs: dict[str, Any], parameters: dict[str, Any], seed: int = 0) -> Record:
    invocation = Invocation(inputs=inputs, parameters=parameters, threads=1, seed=seed)
    return execute("inpaint3d.stages.nerf_pretraining", store, invocation, io.StringIO())


def artifact(store: Store, record: Record) -> Artifact[RadianceFieldArtifact]:
    return store.open(record.outputs["radiance-field"], RadianceFieldArtifact)


def curve_of(result: Artifact[RadianceFieldArtifact]) -> list[dict[str, str]]:
    with result.path(result.metadata.learning_curve).open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def fitted(scene: SyntheticScene, tmp_path_factory: pytest.TempPathFactory) -> tuple[Store, Record]:
    store = FolderStore(tmp_path_factory.mktemp("store"))
    inputs = {"posed-capture": posed(store, scene), "effect-plan": plan(store, "view-dependence")}
    return store, run(store, inputs, SMALL)


def test_it_beats_the_mean_colour_and_the_nearest_photo(scene: SyntheticScene, fitted: tuple[Store, Record]) -> None:
    score = artifact(*fitted).metadata.held_out_psnr
    train = [i for i in range(16) if i not in TEST_VIEWS]
    mean = scene.images[train].mean((0, 1, 2))
    trivial = []
    for i in TEST_VIEWS:
        nearest = min(train, key=lambda k: float(np.linalg.norm(scene.cameras[k].centre - scene.cameras[i].centre)))
        truth = scene.images[i]
        trivial.append([psnr(np.broadcast_to(mean, truth.shape), truth), psnr(scene.images[nearest], truth)])
    assert score is not None
    assert score > np.mean(trivial, 0).max() + 3


def test_depths_are_nearer_the_room_than_any_constant(scene: SyntheticScene, fitted: tuple[Store, Record]) -> None:
    result = artifact(*fitted)
    errors, constant = [], np.median(np.abs(np.median(scene.depths) / scene.depths - 1))
    for view, depth in zip(result.metadata.views, scene.depths, strict=True):
        maps = read_exr(result.path(view.maps))
        assert maps["opacity.A"].mean() > 0.95
        errors.append(np.median(np.abs(maps["median.Z"] / depth - 1)))
    assert np.mean(errors) < constant / 2


def test_right_cameras_leave_no_doubt(fitted: tuple[Store, Record]) -> None:
    assert fitted[1].doubts == ()


def test_pictures_under_the_cameras_of_others_cannot_be_right(store: Store, scene: SyntheticScene) -> None:
    order = np.random.default_rng(0).permutation(len(scene.images))
    shuffled = replace(scene, images=scene.images[order])
    inputs = {"posed-capture": posed(store, shuffled), "effect-plan": plan(store, "view-dependence")}
    (doubt,) = run(store, inputs, SMALL | {"steps": 200}).doubts
    assert "the mean colour of the photos" in doubt


def test_learning_curve_rises_and_its_times_are_in_the_sidecar(fitted: tuple[Store, Record]) -> None:
    store, record = fitted
    result = artifact(store, record)
    rows = curve_of(result)
    assert [row["step"] for row in rows] == ["250", "500"]
    assert float(rows[1]["psnr"]) > float(rows[0]["psnr"])
    assert int(rows[1]["rays"]) == 500 * 256
    timed = record.timings["series"]["learning_curve"]
    assert [row["step"] for row in timed] == [250, 500]
    assert timed[1]["cpu_s"] > timed[0]["cpu_s"] > 0


@pytest.mark.parametrize("effect", ["contraction", "exposure", "view-dependence"])
def test_an_effect_that_is_off_is_absent(store: Store, scene: SyntheticScene, effect: str) -> None:
    every = {"contraction", "exposure", "view-dependence"}
    inputs = {"posed-capture": posed(store, scene), "effect-plan": plan(store, *(every - {effect}))}
    result = artifact(store, run(store, inputs, TINY))
    spec = result.metadata.spec
    with safe_open(result.path("weights.safetensors"), "np") as weights:
        names = set(weights.keys())
    assert spec.contraction == (effect != "contraction")
    assert ("codes" in names) == (effect != "exposure")
    assert any(name.startswith("specular") for name in names) == (effect != "view-dependence")
    # without contraction rays end behind the cube that holds the room, not at infinity
    assert (spec.far < 10) == (effect == "contraction")
    assert load_field(result.path("weights.safetensors"), spec).spec == spec


def test_a_frame_that_is_left_out_changes_no_weight(store: Store, scene: SyntheticScene) -> None:
    spoilt = scene.images.copy()
    spoilt[5] = (1, 0, 1)
    left_out = EffectPlan(effects=(), ignored=(IgnoredFrame(name=scene.names[5], effect="blur"),))
    for_all = store.put(store.private_folder(), "effect-plan", left_out)
    digests = []
    for images in (scene.images, spoilt):
        inputs = {"posed-capture": posed(store, replace(scene, images=images)), "effect-plan": for_all}
        digests.append(file_digest(artifact(store, run(store, inputs, TINY)).path("weights.safetensors")))
    assert digests[0] == digests[1]


def test_stopped_it_goes_on_as_if_nothing_had_happened(store: Store, tmp_path: Path, scene: SyntheticScene) -> None:
    capture = store.open(posed(store, scene), PosedCapture)
    effects = store.open(plan(store, "exposure", "view-dependence"), EffectPlan).metadata
    config = Config.model_validate(TINY)
    views = load_posed(capture)
    cameras, sparse = [v.camera for v in views], load_points(capture.path(capture.metadata.points))
    pixels = Pixels.of(cameras, [v.image() for v in views], [v.valid() for v in views])
    known = Known(pixels, SightLines.of(cameras, sparse))
    centre_depth = capture.metadata.centre_depth
    points = np.zeros((0, 3), np.float32)
    spec = field_spec(config.architecture, effects, views=len(views), centre_depth=centre_depth, points=points)

    def fitted_in(folder: str, *, stop: bool = False) -> tuple[RadianceField, list[list[float]]]:
        def emit(event: str, **values: Any) -> None:
            ctx.stopping = stop  # SIGTERM arrives while the first step is done

        (tmp_path / folder).mkdir(exist_ok=True)
        ctx = Context(seed=0, device="cpu", threads=1, work=tmp_path / folder, emit=emit)
        field = RadianceField(spec, 0)
        return field, fit(field, known, HeldOut.on_lattice([KnownPhoto.of(views[0])], 12, "cpu"), config, ctx)

    whole, curve = fitted_in("whole")
    with pytest.raises(InterruptedRun):
        fitted_in("stopped", stop=True)
    with safe_open(tmp_path / "stopped" / "checkpoint.safetensors", "pt") as checkpoint:
        assert checkpoint.get_tensor("steps") == 1
    again, curve_again = fitted_in("stopped")
    assert curve == curve_again
    for name, weight in whole.state_dict().items():
        assert torch.equal(weight, again.state_dict()[name]), name


def test_results_do_not_depend_on_the_number_of_threads(store: Store, scene: SyntheticScene) -> None:
    inputs = {"posed-capture": posed(store, scene), "effect-plan": plan(store, "contraction", "view-dependence")}
    weights = []
    for threads in (1, 2):
        other = FolderStore(store.root.parent / f"threads-{threads}")
        (other.root / "objects").rmdir()
        (other.root / "objects").symlink_to(store.root / "objects")
        invocation = Invocation(inputs=inputs, parameters=TINY | {"rays": 512, "first_rays": 512}, threads=threads)
        record = execute("inpaint3d.stages.nerf_pretraining", other, invocation, io.StringIO())
        weights.append(artifact(other, record).path("weights.safetensors").read_bytes())
    assert weights[0] == weights[1]


def test_a_capture_without_training_views_is_refused(store: Store, scene: SyntheticScene) -> None:
    inputs = {"posed-capture": posed(store, scene, test=tuple(range(16))), "effect-plan": plan(store)}
    with pytest.raises(BadInputError, match="none of the 16 posed views is for training"):
        run(store, inputs, TINY)


def test_without_held_out_views_there_is_no_score(store: Store, scene: SyntheticScene) -> None:
    inputs = {"posed-capture": posed(store, scene, test=()), "effect-plan": plan(store)}
    result = artifact(store, run(store, inputs, TINY))
    assert result.metadata.held_out_psnr is None
    rows = curve_of(result)
    assert {row["psnr"] for row in rows} == {""}


def test_a_single_sample_a_ray_is_a_configuration_error(store: Store, scene: SyntheticScene) -> None:
    inputs = {"posed-capture": posed(store, scene), "effect-plan": plan(store)}
    with pytest.raises(ConfigurationError, match="samples"):
        run(store, inputs, {"architecture": {"samples": 1}})
