"""Properties of the public maths functions under any input that hypothesis finds; the same examples every time.

`INPAINT3D_EXAMPLES=2000` asks for more of each, drawn anew: `make test-properties`.
"""

import os

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from inpaint3d.diffusion.fill import pyramid_fill
from inpaint3d.diffusion.parameterisation import Parameterisation
from inpaint3d.diffusion.samplers import ddim, uniform_times
from inpaint3d.diffusion.schedules import alpha, cosine_log_snr, cosine_time, sigma
from inpaint3d.radiance import safe
from inpaint3d.radiance.backends import AdamStep, select
from inpaint3d.radiance.contraction import contract
from inpaint3d.radiance.directions import spherical_harmonics
from inpaint3d.radiance.losses import charbonnier, distortion
from inpaint3d.radiance.spacing import Spacing, below_limit
from inpaint3d.radiance.volume import alpha_weights, median_distance
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.colour import from_bytes, linear_from_srgb, srgb_from_linear, to_bytes
from inpaint3d.scene.effects.contraction import cube_half_side
from inpaint3d.scene.finite import find_non_finite
from inpaint3d.scene.geometry import Similarity, ray_sphere, rotation_about_z, rotation_between
from inpaint3d.scene.morphology import close, grow, shrink
from inpaint3d.scene.windows import draw_window, sum_boxes
from inpaint3d.stages.pose_estimation.model import round_pose

EXAMPLES = int(os.environ.get("INPAINT3D_EXAMPLES", "0"))
quick = settings(max_examples=EXAMPLES or 25, derandomize=not EXAMPLES, deadline=None, database=None)

FLOAT32 = st.floats(width=32, allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(0, float(np.float32(1e38)), width=32)
SHARE = st.floats(0, 1, width=32)
COORDINATE = st.floats(-1e6, 1e6)


def floats32(shape, elements=FLOAT32):
    return hnp.arrays(np.float32, shape, elements=elements)


def tensors(shape, elements=FLOAT32):
    return floats32(shape, elements).map(torch.from_numpy)


SMALL_PICTURES = tensors((1, 3, 2, 2), st.floats(-3, 3, width=32))
LENGTHS = tensors((3, 5), st.floats(0, 1e3, width=32))


@quick
@given(tensors((3, 5), st.floats(0, float(np.float32(1e30)), width=32)), LENGTHS)
def test_weights_are_chances(density: torch.Tensor, lengths: torch.Tensor) -> None:
    tdist = torch.cumsum(torch.cat([torch.ones(3, 1), lengths], 1), 1)
    x = density.requires_grad_()
    weights = alpha_weights(x, tdist)
    weights.sum().backward()
    assert weights.detach().min() >= 0
    assert weights.detach().sum(1).max() <= 1 + 1e-5
    assert x.grad is not None
    assert x.grad.isfinite().all()
    far = 1e6
    found = median_distance(weights.detach(), tdist, far, 1e-3)
    assert ((found == far) | ((found >= tdist[:, 0]) & (found <= tdist[:, -1]))).all()


@quick
@given(
    tensors((2, 6), POSITIVE), LENGTHS.map(lambda x: x[:2]), st.integers(2, 9), st.sampled_from(["reference", "native"])
)
def test_resampled_intervals_are_sorted_within_the_ray(
    weights: torch.Tensor, lengths: torch.Tensor, count: int, backend: str
) -> None:
    ends = torch.cumsum(torch.cat([torch.zeros(2, 1), torch.ones(2, 1), lengths], 1), 1)
    drawn = select("cpu", backend).resample(ends / ends[:, -1:], weights, count)  # pyright: ignore[reportArgumentType]
    usable = weights.double().sum(1) < 3e38
    assert drawn[usable].isfinite().all()
    assert (drawn[usable].diff() >= -1e-6).all()
    assert ((drawn[usable] >= 0) & (drawn[usable] <= 1)).all()


@quick
@given(tensors(4), tensors(4))
def test_exp_and_sigmoid_are_bounded_and_keep_a_slope(x: torch.Tensor, slope: torch.Tensor) -> None:
    for function, top in ((safe.exp, 3.3e6), (safe.sigmoid, 1.0)):
        leaf = x.clone().requires_grad_()
        made = function(leaf)
        assert ((made >= 0) & (made <= top)).all()
        made.backward(slope.clamp(-1e30, 1e30))
        assert leaf.grad is not None
        assert leaf.grad.isfinite().all()
        # No slope turns round, and none vanishes for good but that of an empty density.
        assert (leaf.grad * slope >= 0).all()


@quick
@given(tensors((5, 3)))
def test_contraction_stays_in_its_ball_and_keeps_directions(x: torch.Tensor) -> None:
    leaf = x.clone().requires_grad_()
    y = contract(leaf)
    y.sum().backward()
    assert leaf.grad is not None
    assert leaf.grad.isfinite().all()
    assert torch.linalg.vector_norm(y.detach(), dim=1).max() <= 2 + 1e-6
    assert (y.detach().sign() * x.sign() >= 0).all()
    inside = x.double().norm(dim=1) < 1 - 1e-6
    assert torch.equal(y.detach()[inside], x[inside])


@quick
@given(tensors(6))
def test_charbonnier_is_at_least_its_residual(x: torch.Tensor) -> None:
    loss = charbonnier(x)
    assert (loss >= x.abs()).all()
    assert (loss >= 0.999e-3).all()


@quick
@given(tensors((2, 5), st.floats(0, 1e3, width=32)), LENGTHS.map(lambda x: x[:2]))
def test_distortion_is_never_negative(weights: torch.Tensor, lengths: torch.Tensor) -> None:
    ends = torch.cumsum(torch.cat([torch.zeros(2, 1), lengths], 1), 1)
    assert (distortion(weights, ends) >= 0).all()


@quick
@given(st.floats(1e-3, 10), st.floats(0, 1e5), st.booleans(), tensors(8, SHARE))
def test_distances_lie_between_near_and_far(near: float, more: float, reciprocal: bool, s: torch.Tensor) -> None:
    t = Spacing(near, near + more, reciprocal).metric_from_normalised(s.sort().values)
    slack = 1e-5 * (1 + near + more)
    assert (t.diff() >= -slack).all()
    assert ((t >= near - slack) & (t <= near + more + slack)).all()


@quick
@given(tensors(5, POSITIVE), st.floats(-4, -0.1), st.floats(1, 1e5))
def test_the_ladder_falls_short_of_its_limit_by_less_and_less(x: torch.Tensor, p: float, premult: float) -> None:
    lacking = below_limit(x.sort().values, p, premult)
    assert (lacking.abs().diff() <= 1e-6 * lacking.abs()[:-1]).all()


@quick
@given(
    tensors(7),
    tensors(7),
    tensors(7, POSITIVE),
    tensors(7),
    st.integers(1, 10**7),
    st.sampled_from(["reference", "native"]),
)
def test_adam_keeps_finite_numbers_finite(
    param: torch.Tensor, m: torch.Tensor, v: torch.Tensor, grad: torch.Tensor, step: int, backend: str
) -> None:
    before = [part.clone() for part in (param, m, v)]
    lost = select("cpu", backend).adam_step(param, grad, m, v, AdamStep(step, 1e-2, 0.9, 0.99, 1e-15))  # pyright: ignore[reportArgumentType]
    assert all(part.isfinite().all() for part in (param, m, v))
    stayed = sum((a == b).all() for a, b in zip(before, (param, m, v), strict=True))
    assert 0 <= lost <= 7
    assert lost < 7 or stayed == 3


@quick
@given(tensors((4, 3), st.floats(-1, 1, width=32)))
def test_harmonics_have_one_length_in_all_directions(x: torch.Tensor) -> None:
    x = x + torch.tensor([0.0, 0.0, 3.0])
    found = spherical_harmonics(x / x.norm(dim=1, keepdim=True))
    torch.testing.assert_close(found.square().sum(1), torch.full((4,), 16 / (4 * np.pi)), rtol=1e-4, atol=0)


@quick
@given(hnp.arrays(np.float32, (40, 3), elements=st.floats(-(2.0**100), 2.0**100, width=32)))
def test_the_cube_holds_the_cameras(points: np.ndarray) -> None:
    assert cube_half_side(points) >= 1.1
    assert np.isfinite(cube_half_side(points))


@quick
@given(tensors(6, SHARE))
def test_levels_of_noise_share_one(t: torch.Tensor) -> None:
    a, s = alpha(t), sigma(t)
    torch.testing.assert_close(a.square() + s.square(), torch.ones(6), rtol=1e-5, atol=0)
    assert (a.sort(descending=True).values.diff() <= 0).all()
    inside = (t > 1e-3) & (t < 1 - 1e-3)
    torch.testing.assert_close(cosine_time(cosine_log_snr(t))[inside], t[inside], rtol=1e-3, atol=1e-5)


@quick
@given(SMALL_PICTURES, SMALL_PICTURES, st.floats(0.01, 0.99), st.sampled_from(["eps", "x0", "v"]))
def test_clean_and_noise_make_the_same_z(output: torch.Tensor, z: torch.Tensor, t: float, kind: str) -> None:
    p = Parameterisation(kind, torch.tensor([t]))  # pyright: ignore[reportArgumentType]
    a, s = p.levels
    made = a * p.clean(output, z, z) + s * p.noise(output, z, z)
    torch.testing.assert_close(made, z, rtol=1e-3, atol=1e-3)


@quick
@given(tensors((1, 3, 4, 4), st.floats(-100, 100, width=32)), st.integers(1, 8))
def test_bounded_samples_end_in_bounds(z: torch.Tensor, steps: int) -> None:
    made = ddim(lambda z, t: z, z, uniform_times(steps), clip=1.0)
    assert made.isfinite().all()
    # At the last level 4.5e-5 of noise is left.
    assert made.abs().max() <= 1 + 1e-4 * (1 + float(z.abs().max()))


@quick
@given(tensors((1, 3, 5, 6), st.floats(-1, 1, width=32)), hnp.arrays(np.bool_, (5, 6)))
def test_fills_stay_within_what_is_known(image: torch.Tensor, hole: np.ndarray) -> None:
    mask = torch.from_numpy(hole).float()[None, None]
    filled = pyramid_fill(torch.where(mask > 0, torch.nan, image), mask)
    assert filled.isfinite().all()
    assert torch.equal(filled[:, :, ~hole], image[:, :, ~hole])
    known = image[:, :, ~hole] if not hole.all() else torch.zeros(1)
    assert filled.max() <= known.max() + 1e-5
    assert filled.min() >= known.min() - 1e-5


@quick
@given(hnp.arrays(np.float64, (5, 3), elements=COORDINATE), st.floats(0.01, 10))
def test_points_come_back_from_their_pixels(points: np.ndarray, away: float) -> None:
    camera = Camera(50, 60, 20, 10, 40, 30, look_at((0, -away, 0.1), (0, 0, 0)))
    xy, z = camera.project(points)
    seen = camera.inside(xy, z) & (z > 1e-6)
    back = camera.unproject(xy[seen], z[seen])
    np.testing.assert_allclose(back, points[seen], rtol=1e-6, atol=1e-6 * (1 + np.abs(points).max()))


@quick
@given(st.tuples(COORDINATE, COORDINATE, COORDINATE), st.tuples(COORDINATE, COORDINATE, COORDINATE))
def test_rotations_are_rotations(a: tuple[float, float, float], b: tuple[float, float, float]) -> None:
    a, b = (np.array(v) + np.array([1e-3, 0, 0]) for v in (a, b))
    turn = rotation_between(a, b)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(turn) == pytest.approx(1, abs=1e-6)


@quick
@given(
    st.floats(1e-6, 1e6),
    st.floats(-720, 720),
    hnp.arrays(np.float64, 3, elements=COORDINATE),
    hnp.arrays(np.float64, (4, 3), elements=COORDINATE),
)
def test_similarities_go_there_and_back(scale: float, yaw: float, shift: np.ndarray, points: np.ndarray) -> None:
    there = Similarity(scale, rotation_about_z(yaw), shift)
    both = there.then(there.inverse())
    size = 1 + np.abs(points).max() + np.abs(shift).max() / scale
    np.testing.assert_allclose(both.points(points), points, rtol=0, atol=1e-9 * size)


@quick
@given(hnp.arrays(np.float64, (4, 3), elements=st.floats(-50, 50)), st.floats(0.01, 5))
def test_spheres_are_left_after_they_are_entered(origins: np.ndarray, radius: float) -> None:
    near, far, hit = ray_sphere(origins, np.tile([0.6, 0.0, 0.8], (4, 1)), [0, 0, 0], radius)
    assert (near[hit] >= 0).all()
    assert (far[hit] >= near[hit]).all()
    assert np.isinf(near[~hit]).all()


@quick
@given(hnp.arrays(np.bool_, (12, 15)), st.integers(0, 4))
def test_masks_grow_and_shrink(mask: np.ndarray, radius: int) -> None:
    assert (grow(mask, radius) >= mask).all()
    assert (shrink(mask, radius) <= mask).all()
    assert (close(mask, radius) >= mask).all()


@quick
@given(hnp.arrays(np.bool_, (20, 26)), st.integers(2, 24), st.floats(0.05, 1), st.integers(0, 1000))
def test_windows_always_show_the_hole(hole: np.ndarray, size: int, span: float, seed: int) -> None:
    window = draw_window(hole, ~hole, 0, size=size, span=span, min_known=0.3, rng=np.random.default_rng(seed))
    assert (window is None) == (not hole.any())
    if window is not None:
        assert window.sample(hole).any()
    assert sum_boxes(hole, 1).sum() == hole.sum()


@quick
@given(hnp.arrays(np.uint8, (3, 4, 3)), floats32((5, 3), SHARE))
def test_colours_come_back(codes: np.ndarray, light: np.ndarray) -> None:
    np.testing.assert_array_equal(to_bytes(from_bytes(codes)), codes)
    np.testing.assert_allclose(linear_from_srgb(srgb_from_linear(light)), light, rtol=2e-4, atol=1e-6)


@quick
@given(hnp.arrays(np.float64, 3, elements=st.floats(-1e9, 1e9)), st.floats(-180, 180))
def test_rounded_poses_are_as_near_as_their_digits(centre: np.ndarray, yaw: float) -> None:
    pose = np.concatenate([rotation_about_z(yaw), centre[:, None]], 1)
    rounded = round_pose(pose)
    np.testing.assert_allclose(rounded[:, :3], pose[:, :3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(rounded[:, 3], centre, rtol=0, atol=1e-8 * max(1.0, np.abs(centre).max()))


@quick
@given(hnp.arrays(np.float32, (3, 4), elements=st.floats(width=32)))
def test_what_is_not_finite_is_counted(array: np.ndarray) -> None:
    found = find_non_finite({"a": array})
    assert sum(f.numbers for f in found) == (~np.isfinite(array)).sum()
