"""Scenes whose effects are known, because they were put there."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import Effect, EffectPlan, LensModel, PosedCapture, Registration
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import FolderStore
from inpaint3d.scene.capture_io import write_points, write_view
from inpaint3d.scene.colour import linear_from_srgb, srgb_from_linear
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.scene_analysis.config import NAMES, Config
from inpaint3d.stages.scene_analysis.run import run

STAGE = load_stage(Path(__file__).parents[1] / "stage.yaml")
IDENTITY = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
PINHOLE = LensModel(model="PINHOLE", params=(150.0, 150.0, 80.0, 60.0), evidence="exact")
ROOM = synthetic_scene(views=10, width=160, height=120, arc_deg=60, points=600)


QUICK = Config(probe_steps=0)


def plan(folder, images=ROOM.images, config=QUICK, xyz=None, lens_effect=None, exif=None) -> dict:
    return {e.name: e for e in analyse(folder, images, config, xyz, lens_effect, exif).metadata.effects}


def analyse(folder, images=ROOM.images, config=QUICK, xyz=None, lens_effect=None, exif=None):
    store = FolderStore(folder / "store")
    inner = store.private_folder()
    points = ROOM.points
    if xyz is not None:
        points = type(points)(**{**vars(points), "xyz": xyz.astype(np.float32)})
    write_points(inner / "points.safetensors", points)
    exif = exif or [None] * len(images)
    views = zip(ROOM.names, images, ROOM.cameras, exif, strict=True)
    frames = tuple(write_view(inner, n, im, c, relative_exposure=e) for n, im, c, e in views)
    registration = Registration(
        source="known", given=10, registered=10, mean_reprojection_error_px=0.0, points=len(points),
        median_triangulation_angle_deg=20.0,
    )  # fmt: skip
    metadata = PosedCapture(
        frames=frames, ordered=True, lens=PINHOLE, lens_effect=lens_effect,
        registration=registration, source_from_normalised_scale=1.0,
        source_from_normalised=IDENTITY, centre_depth=0.85, up_evidence="exact",
    )  # fmt: skip
    inputs = Inputs(store, STAGE, {"posed-capture": store.put(inner, "posed-capture", metadata)})
    outputs = Outputs(store, STAGE)
    work = store.private_folder()
    ctx = Context(seed=0, device="cpu", threads=1, work=work, emit=lambda event, **values: None)
    run(config, inputs, outputs, ctx)
    return store.open(outputs.store_all()["effect-plan"], EffectPlan)


def brightened(ev):
    gains = 2.0 ** np.asarray(ev)[:, None, None, None]
    return srgb_from_linear(linear_from_srgb(ROOM.images) * gains).astype(np.float32)


def test_an_ideal_camera_in_a_dull_room_calls_for_nothing(tmp_path):
    effects = plan(tmp_path)
    assert {name: e.state for name, e in effects.items()} == dict.fromkeys(NAMES, "off")
    assert effects["exposure"].evidence["gain_spread_ev"] < 0.03


def test_exposure_drift_is_found_and_measured(tmp_path):
    drift = np.linspace(-0.3, 0.3, 10)
    effect = plan(tmp_path, brightened(drift))["exposure"]
    assert effect.state == "on"
    assert effect.evidence["gain_spread_ev"] == pytest.approx(0.48, abs=0.05)  # 80 % of 0.6
    assert f"differs between views by {effect.evidence['gain_spread_ev']:.2f} EV" in effect.reason


def test_exposure_drift_is_not_taken_for_view_dependence(tmp_path):
    assert plan(tmp_path, brightened(np.linspace(-0.3, 0.3, 10)))["view-dependence"].state == "off"


def test_automatic_exposure_that_leaves_no_trace_in_the_pictures_is_off(tmp_path):
    effect = plan(tmp_path, exif=list(2.0 ** np.linspace(-1, 1, 10)))["exposure"]
    assert effect.state == "off"
    assert effect.evidence["exif_spread_ev"] == pytest.approx(1.6, abs=0.01)


def test_without_usable_colours_the_cameras_word_decides(tmp_path):
    white = np.ones_like(ROOM.images)
    assert plan(tmp_path / "a", white, exif=list(2.0 ** np.linspace(-1, 1, 10)))["exposure"].state == "on"
    assert plan(tmp_path / "b", white)["exposure"].state == "off"


def test_a_sheen_that_moves_with_the_camera_is_found(tmp_path):
    # Everything is brighter where it is seen from one direction, as a glossy surface is from the mirrored lamp's.
    images = []
    for image, camera, depth in zip(ROOM.images, ROOM.cameras, ROOM.depths, strict=True):
        points = camera.unproject(camera.pixel_centres(), depth)
        to_camera = camera.centre - points
        to_camera /= np.linalg.norm(to_camera, axis=-1, keepdims=True)
        lobe = np.exp(-0.5 * (np.arccos(np.clip(to_camera @ [0.0, -0.9, 0.436], -1, 1)) / 0.15) ** 2)
        images.append(srgb_from_linear(linear_from_srgb(image) * (1 + 0.7 * lobe[..., None])))
    effects = plan(tmp_path, np.stack(images).astype(np.float32))
    assert effects["view-dependence"].state == "on"


def test_a_far_background_calls_for_contraction(tmp_path):
    xyz = ROOM.points.xyz.astype(np.float64)
    xyz[::10] *= 30
    effect = plan(tmp_path, xyz=xyz)["contraction"]
    assert effect.state == "on"
    assert effect.evidence["share_beyond_far_radius"] == pytest.approx(0.1, abs=0.005)


def test_what_was_decided_about_the_lens_is_taken_over(tmp_path):
    decided = Effect(name="lens-distortion", state="on", evidence={"corner_px": 3.0}, reason="bends")
    assert plan(tmp_path, lens_effect=decided)["lens-distortion"] == decided


def test_blurred_frames_are_left_out_and_named(tmp_path):
    images = ROOM.images.copy()
    images[4] = cv2.GaussianBlur(images[4], (0, 0), 3.0)
    found = analyse(tmp_path, images).metadata
    assert [(one.name, one.effect, one.mask) for one in found.ignored] == [(ROOM.names[4], "blur", None)]
    off = analyse(tmp_path / "off", images, Config(force={"blur": False}, probe_steps=0)).metadata
    assert off.ignored == ()


def test_what_passes_by_is_masked(tmp_path):
    found = analyse(tmp_path, config=Config(force={"transients": True}, probe_steps=0))
    assert found.metadata.active("transients")
    assert found.metadata.ignored == ()  # nobody is there


def test_costs_lie_beside_the_artifact_and_not_in_it(tmp_path):
    found = analyse(tmp_path / "a", config=Config(probe_steps=1))
    assert found.metadata == analyse(tmp_path / "b").metadata


def test_force_overrules_and_keeps_the_evidence(tmp_path):
    config = Config.model_validate({"force": {"exposure": "on", "view-dependence": False}, "probe_steps": 0})
    effects = plan(tmp_path, config=config)
    assert effects["exposure"].state == "forced-on"
    assert effects["exposure"].active
    assert effects["exposure"].evidence["gain_spread_ev"] < 0.03
    assert effects["view-dependence"].state == "forced-off"


def test_an_unknown_effect_cannot_be_forced():
    with pytest.raises(ValueError, match="fog"):
        Config.model_validate({"force": {"fog": True}})


def test_what_nothing_simulates_cannot_be_switched_on():
    with pytest.raises(ValueError, match="vignetting cannot be switched on"):
        Config.model_validate({"force": {"vignetting": True}})
    assert Config.model_validate({"force": {"vignetting": False}}).force == {"vignetting": False}
