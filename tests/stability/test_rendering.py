"""Volume rendering, sampling along rays and the losses on them: values and gradients, against float64."""

import math

import pytest
import torch

from inpaint3d.radiance import safe
from inpaint3d.radiance.backends import Backend, reference, select
from inpaint3d.radiance.contraction import contract, unit_cube
from inpaint3d.radiance.line_of_sight import opacity_before
from inpaint3d.radiance.losses import charbonnier, depth_smoothness_loss, distortion
from inpaint3d.radiance.optim import learning_rate
from inpaint3d.radiance.spacing import Spacing, below_limit
from inpaint3d.radiance.training import proposal_anneal, rays_at
from inpaint3d.radiance.volume import alpha_weights, median_distance
from tests.stability.catalogue import hard_case

LARGEST = torch.finfo(torch.float32).max
MAGNITUDES = [0.0, 1e-38, 1e-30, 1e-20, 1e-10, 1e-8, 1e-4, 1.0, 1e4, 1e10, 1e20, 1e30, LARGEST]
BACKENDS = ["reference", "native"]
RENDERING, SAMPLING, LOSSES, SCHEDULES = "Volume rendering", "Sampling along rays", "Losses", "Schedules"


def ulp(value: torch.Tensor, truth: torch.Tensor) -> float:
    """Largest distance in units of the last place of float32, denormal ones counted as the least normal."""
    spacing = torch.finfo(torch.float32).eps * truth.abs().clamp(min=torch.finfo(torch.float32).tiny)
    return float(((value.double() - truth).abs() / spacing).max())


def backend_of(name: str) -> Backend:
    if name == "native":
        pytest.importorskip("inpaint3d.kernels", exc_type=ImportError)
    return select("cpu", name)  # pyright: ignore[reportArgumentType]


@hard_case(
    RENDERING,
    plain="1 - exp(-x) is 0 in float32 below x = 6e-8: thin fog is no fog",
    ours="-expm1(-x)",
    swept="optical depth 0 to 3.4e38; value and gradient within 4 ulp of float64",
)
@pytest.mark.parametrize("density", MAGNITUDES)
def test_a_single_interval(density: float) -> None:
    x = torch.tensor([[density]], requires_grad=True)
    (weight,) = alpha_weights(x, torch.tensor([[0.0, 1.0]]))[0]
    weight.backward()
    exact = -torch.expm1(-x.detach().double())
    assert x.grad is not None
    assert ulp(weight.detach()[None, None], exact) <= 4
    assert ulp(x.grad, torch.exp(-x.detach().double())) <= 4


@hard_case(
    RENDERING,
    plain="cumsum(x) - x forgets the fog in front of an opaque wall: 1e8 swallows it",
    ours="the sum is shifted, not subtracted",
    swept="fog of 1e-8 to 1e-1 before walls of 1e3 to 1e30",
)
@pytest.mark.parametrize("fog", [1e-8, 1e-6, 1e-3, 1e-1])
@pytest.mark.parametrize("wall", [1e3, 1e10, 1e30])
@pytest.mark.parametrize("backend", BACKENDS)
def test_fog_before_a_wall(fog: float, wall: float, backend: str) -> None:
    density = torch.tensor([[fog, wall, 1.0]])
    tdist = torch.tensor([[0.0, 1.0, 2.0, 3.0]])
    weights = backend_of(backend).composite(density, torch.zeros(1, 3, 3), tdist)[0]
    expected = torch.tensor([-math.expm1(-fog), math.exp(-fog), 0.0], dtype=torch.float64)
    torch.testing.assert_close(weights[0].double(), expected, rtol=1e-6, atol=0)


@hard_case(
    RENDERING,
    plain="0 * inf and inf - inf: a zero-length interval at a huge density, an infinite one without density",
    ours="the product comes first, and only finite intervals are asked for",
    swept="lengths 0 to 1e30 at densities 0 to 1e8; weights >= 0 that sum to at most 1, finite gradients",
)
@pytest.mark.parametrize("length", [0.0, 1e-30, 1e-10, 1.0, 1e10, 1e30])
@pytest.mark.parametrize("density", [0.0, 1.0, 1e8])
@pytest.mark.parametrize("backend", BACKENDS)
def test_lengths_of_intervals(length: float, density: float, backend: str) -> None:
    densities = torch.full((1, 4), density, requires_grad=True)
    tdist = torch.tensor([[0.0, length, 2 * length, 3 * length, 4 * length]])
    weights, colour, opacity, _ = backend_of(backend).composite(densities, torch.ones(1, 4, 3), tdist)
    (weights.sum() + colour.sum() + opacity.sum()).backward()
    assert weights.detach().min() >= 0
    assert float(weights.detach().sum()) <= 1 + 1e-6
    assert densities.grad is not None
    assert densities.grad.isfinite().all()
    assert float(opacity.detach()) == pytest.approx(-math.expm1(-4 * density * length), rel=1e-5)


@hard_case(
    RENDERING,
    plain="0 / 0 on rays that meet nothing",
    ours="the divisor is guarded: `far`, with no gradient",
    swept="rays of opacity 0, 1e-30, below and above the threshold",
)
@pytest.mark.parametrize("weight", [0.0, 1e-30, 0.9e-3, 1.1e-3, 1.0])
def test_depth_of_empty_rays(weight: float) -> None:
    weights = torch.tensor([[weight, 0.0]], requires_grad=True)
    depth = safe.divide((weights * torch.tensor([[2.0, 4.0]])).sum(1), weights.sum(1), 1000.0, 1e-3)
    depth.sum().backward()
    assert weights.grad is not None
    assert weights.grad.isfinite().all()
    assert float(depth.detach()) == pytest.approx(1000.0 if weight < 1e-3 else 2.0)
    found = median_distance(weights.detach(), torch.tensor([[1.0, 3.0, 5.0]]), 1000.0, 1e-3)
    assert float(found) == pytest.approx(1000.0 if weight < 1e-3 else 2.0)


@hard_case(
    RENDERING,
    plain="comparisons with NaN are False: where(total > 0, depth, far) calls a broken ray an empty one",
    ours="asked the other way round, so that what is not finite stays so",
    swept="NaN and inf in the first, a middle and the last weight",
    told="the first checkpoint, picture or commit after it says where (exit code 1)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("at", [0, 2, 4])
def test_broken_rays_are_not_empty(value: float, at: int) -> None:
    weights = torch.full((1, 5), 0.1)
    weights[0, at] = value
    tdist = torch.linspace(1, 6, 6)[None]
    assert median_distance(weights, tdist, 1000.0, 1e-3).isnan().all()
    total = weights.sum(1)
    assert not safe.divide(total * 2, total, 1000.0, 1e-3).isfinite().any()


@hard_case(
    RENDERING,
    plain="w of less than an ulp of the sum before it: (half - before) / w is 1.7, a depth beyond its interval",
    ours="the share of an interval is bounded by it",
    swept="sums of 2^-40 to 2^20 before an interval of 0.6 ulp, lengths 1 and 1e6",
)
@pytest.mark.parametrize("before", [2.0**-40, 0.25, 2.0**20])
@pytest.mark.parametrize("length", [1.0, 1e6])
def test_half_of_the_opacity_lies_in_its_interval(before: float, length: float) -> None:
    ulp_of = before * torch.finfo(torch.float32).eps
    weights = torch.tensor([[before, 0.6 * ulp_of, before + ulp_of]])
    found = median_distance(weights, torch.tensor([[1.0, 2.0, 2.0 + length, 3.0 + length]]), 1e9, 0.0)
    assert float(found) == 2 + length


@hard_case(
    SAMPLING,
    plain="63 + jitter rounds to 64 for jitter > 1 - 2e-6: 0 / 0 in a last interval without mass",
    ours="gaps of 0 are no divisors",
    swept="the largest jitter below 1, 2 to 512 new intervals, no mass in the last old ones",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("count", [2, 64, 512])
def test_the_last_stratum_is_full(backend: str, count: int) -> None:
    jitter = torch.full((1, count), 1 - 2.0**-24)
    drawn = backend_of(backend).resample(
        torch.linspace(0, 1, 5)[None], torch.tensor([[1.0, 1e3, 0.0, 0.0]]), count, jitter
    )
    assert drawn.isfinite().all()
    assert (drawn.diff() >= 0).all()
    assert 0 <= drawn.min() <= drawn.max() <= 1


@hard_case(
    SAMPLING,
    plain="0 / 0 in the inverse CDF of an empty histogram; ties and one-hot histograms divide by a gap of 0",
    ours="an eps of mass by length; gaps of 0 are no divisors",
    swept="histograms all zero, one-hot, subnormal, 1e-38 to 1e30, with ties and intervals without length",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    "weights",
    [
        [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1e-45, 1e-44, 0.0, 1e-45], [1.0, 1.0, 1.0, 1.0],
        [1e-38, 0.0, 0.0, 1e-38], [1e30, 1.0, 1e-30, 0.0], [0.5, 0.0, 0.0, 0.5],
    ],
    ids=["zero", "one-hot", "subnormal", "even", "tiny", "huge", "gap"],
)  # fmt: skip
@pytest.mark.parametrize("flat", [False, True], ids=["spread", "tie"])
def test_any_histogram_is_resampled(backend: str, weights: list[float], flat: bool) -> None:
    ends = torch.tensor([[0.0, 0.25, 0.25 if flat else 0.5, 0.75, 1.0]])
    drawn = backend_of(backend).resample(ends, torch.tensor([weights]), 6)
    assert drawn.isfinite().all()
    assert (drawn.diff() >= 0).all()
    assert drawn.min() >= 0
    assert drawn.max() <= 1


@hard_case(
    SAMPLING,
    plain="a NaN is not found by a search, and gave finite ends by the native kernel, the reference's NaN",
    ours="a histogram that is not finite gives NaN, by both",
    swept="NaN and inf in the first, a middle and the last weight, and in an end",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("at", [0, 2, 3, "end"])
def test_a_broken_histogram_gives_nothing(backend: str, value: float, at: int | str) -> None:
    ends, weights = torch.linspace(0, 1, 5)[None].clone(), torch.ones(1, 4)
    if isinstance(at, int):
        weights[0, at] = value
    else:
        ends[0, 2] = value
    drawn = backend_of(backend).resample(ends, weights, 5)
    assert drawn.isnan().all()


@hard_case(
    SAMPLING,
    plain="1 / t - 1 cancels at the far end; near = far divides by nothing",
    ours="both shares are added",
    swept="near 1e-6 to far 1e6, near = far; the ends within 2 ulp, sorted in between",
)
@pytest.mark.parametrize(("near", "far"), [(1e-6, 1e6), (0.1, 1000.0), (1.0, 1.0), (0.05, 0.0500001), (1e3, 1e5)])
@pytest.mark.parametrize("reciprocal", [True, False])
def test_distances_along_a_ray(near: float, far: float, reciprocal: bool) -> None:
    s = torch.linspace(0, 1, 65)
    t = Spacing(near, far, reciprocal).metric_from_normalised(s)
    assert (t.diff() >= -1e-6 * t[1:].abs() - 2e-7).all()
    # 1 + t is what is reckoned in: an ulp of it.
    assert float(t[0]) == pytest.approx(near, abs=3e-7, rel=1e-6)
    assert float(t[-1]) == pytest.approx(far, abs=3e-7, rel=2e-6)


@hard_case(
    SAMPLING,
    plain="|x| has no gradient at 0 and overflows at 1e19; 1/|x| is infinite at the origin",
    ours="divided by the largest coordinate, exact inside the unit ball",
    swept="points at 0, on the sphere, 1e-30 to 3e38 away; finite gradients; relative 1e-6",
)
@pytest.mark.parametrize("radius", [0.0, 1e-30, 1e-10, 0.5, 1.0, 1.0 + 1e-6, 2.0, 1e4, 1e19, 1e30, 1e38])
def test_contraction(radius: float) -> None:
    direction = torch.tensor([[0.6, 0.0, -0.8]])
    x = (radius * direction).requires_grad_()
    y = contract(x)
    y.sum().backward()
    assert x.grad is not None
    assert x.grad.isfinite().all()
    expected = radius if radius <= 1 else 2 - 1 / radius
    torch.testing.assert_close(y.detach(), expected * direction, rtol=1e-6, atol=0)
    native = backend_of("native").unit_cube(x.detach(), True, 1.0)
    torch.testing.assert_close(native, unit_cube(x.detach(), True, 1.0), rtol=1e-6, atol=0)


@hard_case(
    LOSSES,
    plain="the paper's sqrt(r^2 - eps^2) is NaN at small residuals; r^2 overflows at 1e19",
    ours="hypot(r, eps)",
    swept="residuals 0 to 3e38, relative 1e-6; gradient at most 1",
)
@pytest.mark.parametrize("residual", [*MAGNITUDES[:-1], 3e38])
def test_charbonnier(residual: float) -> None:
    x = torch.tensor([residual], requires_grad=True)
    loss = charbonnier(x)
    loss.sum().backward()
    exact = math.hypot(residual, 1e-3)
    assert float(loss.detach()) == pytest.approx(exact, rel=1e-6, abs=0)
    assert x.grad is not None
    assert float(x.grad) == pytest.approx(residual / exact, rel=1e-6, abs=0)


@hard_case(
    LOSSES,
    plain="P(t, p) saturates: with premult 20000 all distances beyond 1000 are one number",
    ours="the difference to its limit",
    swept="distances 0 to 1e30; strictly falling, relative 1e-5 of float64",
)
@pytest.mark.parametrize("distance", [0.0, 1e-10, 1e-4, 1.0, 1e3, 1e6, 1e10, 1e20])
def test_the_power_ladder_does_not_saturate(distance: float) -> None:
    x = torch.tensor([distance, distance * 1.001 + 1e-6])
    here, beyond = below_limit(x, -1.0, 20000.0).abs()
    assert here > beyond > 0
    exact = 2 / (20000.0 * distance / 2 + 1)
    assert float(here) == pytest.approx(exact, rel=1e-5, abs=0)


@hard_case(
    LOSSES,
    plain="the double sum over pairs cancels; a wall of weight 1 has a spread of 0",
    ours="the gap between neighbours counts for all pairs that it separates: only positive terms",
    swept="weights 0, 1e-30, one-hot, even; intervals 1e-12 to 1e12; relative 1e-5 of the float64 double sum",
)
@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 1e6, 1e12])
@pytest.mark.parametrize("kind", ["zero", "tiny", "one-hot", "even"])
def test_distortion(scale: float, kind: str) -> None:
    weights = {
        "zero": torch.zeros(6), "tiny": torch.full((6,), 1e-15), "one-hot": torch.eye(6)[2], "even": torch.ones(6) / 6
    }[kind].clone().requires_grad_()  # fmt: skip
    ends = scale * torch.tensor([0.0, 0.1, 0.4, 0.5, 0.9, 2.0, 3.0])
    loss = distortion(weights, ends)
    loss.backward()
    w, e = weights.detach().double(), ends.double()
    middle = (e[1:] + e[:-1]) / 2
    exact = (w[:, None] * w * (middle[:, None] - middle).abs()).sum() + (w.square() * e.diff()).sum() / 3
    assert float(loss.detach()) == pytest.approx(float(exact), rel=1e-5, abs=1e-37)
    assert weights.grad is not None
    assert weights.grad.isfinite().all()


@hard_case(
    LOSSES,
    plain="g^2 / (w + eps) of a histogram without weight; ends that coincide",
    ours="eps of float32 beside the weight",
    swept="weights 0, 1e-38, one-hot, 1; both backends, forward and backward",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("own", [0.0, 1e-38, 1e-7, 1.0])
@pytest.mark.parametrize("other", [0.0, 1e-38, 1.0])
def test_interlevel(backend: str, own: float, other: float) -> None:
    ends = torch.tensor([[0.0, 0.5, 0.5, 1.0]])
    weights, bound = torch.tensor([[own, own, 0.0]]), torch.tensor([[other, 0.0]], requires_grad=True)
    loss = backend_of(backend).interlevel(ends, weights, torch.tensor([[0.0, 0.6, 1.0]]), bound)
    loss.sum().backward()
    exact = 2 * max(own - other, 0.0) ** 2 / (own + 1.1920929e-07)
    # An interval of no length overlaps what it lies in.
    assert float(loss.detach()) == pytest.approx(exact, rel=1e-5, abs=torch.finfo(torch.float32).tiny)
    assert bound.grad is not None
    assert bound.grad.isfinite().all()


@hard_case(
    LOSSES,
    plain="(d - low) / (high - low) with an interval of no length; a point in the camera, or beyond the ray's end",
    ours="the least normal number for a length",
    swept="distances -1 to 1e30; opacity before it within [0, total], finite gradients",
)
@pytest.mark.parametrize("distance", [-1.0, 0.0, 1e-30, 1.0, 2.0, 1e30])
def test_opacity_before_a_point(distance: float) -> None:
    weights = torch.full((1, 3), 0.25, requires_grad=True)
    tdist = torch.tensor([[1.0, 2.0, 2.0, 3.0]])
    before = opacity_before(weights, tdist, torch.tensor([distance]))
    before.sum().backward()
    assert 0 <= float(before.detach()) <= 0.75
    assert weights.grad is not None
    assert weights.grad.isfinite().all()


@hard_case(
    LOSSES,
    plain="squares of depth steps at empty rays (far = 1000) beside surfaces",
    ours="bilateral weights of colours; float32 holds 1e6",
    swept="steps of depth 0 to 1e9, of colour 0 to 1",
)
@pytest.mark.parametrize("step", [0.0, 1e-20, 1.0, 1e3, 1e9])
@pytest.mark.parametrize("colour", [0.0, 1.0])
def test_depth_smoothness(step: float, colour: float) -> None:
    depth = torch.tensor([[[1.0, 1.0 + step], [1.0, 1.0 + step]]], requires_grad=True)
    rgb = torch.tensor([[[[0.0] * 3, [colour] * 3]] * 2])
    loss = depth_smoothness_loss(depth, rgb)
    loss.backward()
    assert loss.isfinite()
    assert depth.grad is not None
    assert depth.grad.isfinite().all()


@hard_case(
    SCHEDULES,
    plain="0 / 0 at fits of no step, warm-up or ramp; the rate at and beyond the last step",
    ours="counts are at least 1 in divisors",
    swept="steps 0, 1, the last, ten times the last, 10^9",
)
@pytest.mark.parametrize("step", [0, 1, 799, 8000, 10**9])
@pytest.mark.parametrize("steps", [0, 1, 800])
def test_schedules_at_both_ends(step: int, steps: int) -> None:
    rate = learning_rate(step, steps=steps, warmup=0)
    assert 0 < rate <= 1e-2
    if step >= max(steps, 1):  # beyond the schedule it falls as 1 / step
        assert rate == pytest.approx(1e-3 * max(steps, 1) / step, rel=1e-9)
    assert 0 <= proposal_anneal(step, steps) <= 1
    assert 1 <= rays_at(step, first=1, last=512, ramp=steps) <= 512


@hard_case(
    RENDERING,
    plain="kernels keep what a comparison leaves, so that NaN comes out as a number",
    ours="native equals reference on NaN and inf, not only on finite numbers",
    swept="NaN, inf and -inf in each argument of each operation, forward and backward",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("at", range(3))
def test_native_composite_and_colours_of_broken_numbers(value: float, at: int) -> None:
    native = backend_of("native")
    density, rgb, tdist = torch.rand(4, 5), torch.rand(4, 5, 3), torch.linspace(1, 2, 6).repeat(4, 1)
    (density, rgb, logits := torch.randn(4, 3))[at].view(4, -1)[1, 2] = value
    if not (at == 0 and value == -math.inf):  # a density is at least 0
        for ours, truth in zip(*(b.composite(density, rgb, tdist) for b in (native, reference)), strict=True):
            assert torch.equal(ours.isfinite(), truth.isfinite())
    shown = [backend.colours(logits, None, None)[0] for backend in (native, reference)]
    assert torch.equal(shown[0].isnan(), shown[1].isnan())


@hard_case(
    SAMPLING,
    plain="the largest of a NaN and a number is either, as it is asked",
    ours="a density that was seen to be NaN stays in its cell, by both backends",
    swept="NaN before, between and after other sightings of the cell",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("at", [0, 1, 2])
def test_a_broken_density_stays_in_its_cell(backend: str, at: int) -> None:
    density, seen = torch.ones(8), torch.tensor([2.0, 3.0, 4.0])
    seen[at] = math.nan
    backend_of(backend).grid_learn(density, 2, torch.full((3, 3), 0.2), seen, 0.5)
    assert density[0].isnan()
    assert density[1:].tolist() == [1.0] * 7


@hard_case(
    SAMPLING,
    plain="a NaN as an index is the most negative number, outside of any table",
    ours="read at the origin, with weights that are NaN",
    swept="points of NaN, inf, outside the cube, on its faces",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -3.0, 0.0, 1.0, 7.0])
def test_any_point_is_encoded(backend: str, value: float) -> None:
    levels = reference.levels_of(2, 4, 8, 8)
    table = torch.rand(levels[-1].offset + levels[-1].size, 2, generator=torch.Generator().manual_seed(0))
    points = torch.full((3, 3), 0.5)
    points[1, 1] = value
    features = backend_of(backend).hash_encode(points, table, levels)
    assert features[[0, 2]].isfinite().all()
    assert bool(features[1].isfinite().all()) == math.isfinite(value)
