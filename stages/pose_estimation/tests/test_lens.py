"""Which lens is chosen, on models made of exact points."""

import numpy as np
import pycolmap
import pytest

from inpaint3d.scene.synthetic import arc_cameras
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.lens import choose_lens, describe_given, measure_corner

WIDTH, HEIGHT, FOCAL = 480, 360, 402.0


def made_lens(k):
    return pycolmap.Camera(
        model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=[FOCAL, WIDTH / 2, HEIGHT / 2, k], camera_id=1
    )


def made_model(k, noise=0.3, points=300, views=8):
    """A reconstruction whose matches a lens of radial coefficient k took, `noise` pixels off."""
    rng = np.random.default_rng(0)
    found, lens = pycolmap.Reconstruction(), made_lens(k)
    found.add_camera_with_trivial_rig(lens)
    xyz = rng.uniform(-0.6, 0.6, (points, 3))
    seen = []
    for index, camera in enumerate(arc_cameras(views, WIDTH, HEIGHT, 80.0)):
        in_cam = xyz @ camera.cam_from_world[:, :3].T + camera.cam_from_world[:, 3]
        xy = np.asarray(lens.img_from_cam(in_cam)) + rng.normal(0, noise, (points, 2))
        image = pycolmap.Image(name=f"{index}.png", camera_id=1, image_id=index + 1, keypoints=xy)
        found.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera.cam_from_world))
        seen.append(np.flatnonzero((xy > 0).all(1) & (xy < (WIDTH, HEIGHT)).all(1)))
    for point in range(points):
        elements = [pycolmap.TrackElement(v + 1, point) for v in range(views) if point in seen[v]]
        if len(elements) > 2:
            found.add_point3D(xyz[point], pycolmap.Track(elements))
    return found


@pytest.mark.parametrize(("k", "state", "lens"), [(0.0, "off", "PINHOLE"), (-0.07, "on", "SIMPLE_RADIAL")])
def test_a_lens_bends_only_where_the_matches_say_so(k, state, lens):
    choice = choose_lens(made_model(k), "auto")
    assert choice.effect.state == state
    assert next(iter(choice.model.cameras.values())).model_name == lens
    assert choice.why.startswith(lens)


def test_by_hand_a_lens_is_a_pinhole_or_bends_all_the_same():
    bent = made_model(-0.07)
    off = choose_lens(bent, "auto", bends=False)
    assert off.effect.state == "forced-off"
    assert off.effect.gain is not None
    assert off.effect.gain.value > 100  # what was measured is told
    assert next(iter(off.model.cameras.values())).model_name == "PINHOLE"
    on = choose_lens(made_model(0.0), "auto", bends=True)
    assert on.effect.state == "forced-on"


@pytest.mark.parametrize(("lens", "state"), [("PINHOLE", "forced-off"), ("OPENCV", "forced-on")])
def test_a_lens_that_is_asked_for_is_taken(lens, state):
    choice = choose_lens(made_model(-0.07), lens)
    assert choice.effect.state == state
    assert next(iter(choice.model.cameras.values())).model_name == lens


def test_the_corner_of_one_radial_coefficient_moves_by_k_r_cubed():
    r = np.hypot(WIDTH / 2, HEIGHT / 2) / FOCAL
    assert measure_corner(made_lens(0.05)) == pytest.approx(FOCAL * 0.05 * r**3)
    assert measure_corner(made_lens(0.0)) == pytest.approx(0, abs=1e-9)  # rounding


def test_a_lens_that_came_with_the_capture_is_described():
    assert describe_given([made_lens(0.0)]).state == "off"
    assert describe_given([made_lens(0.0), made_lens(0.05)]).state == "on"


@pytest.mark.parametrize("other", [{"lens": "OPENCV"}, {"cameras": "known"}])
def test_two_who_decide_the_lens_are_refused(other):
    with pytest.raises(ValueError, match="decides it too"):
        Config.model_validate({"force": {"lens-distortion": False}, **other})
