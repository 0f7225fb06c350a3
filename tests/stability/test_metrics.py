"""Metrics of pictures and sets of features that are degenerate or broken."""

import math

import numpy as np
import pytest

from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.ssim import ssim
from inpaint3d.stages.evaluation.frechet import frechet_distance, kernel_distance
from inpaint3d.stages.evaluation.hole import gradient_ratio, gradient_share, opacity_figures
from tests.stability.catalogue import hard_case

METRICS = "Metrics"
PICTURE = np.random.default_rng(0).random((24, 20, 3)).astype(np.float32)


@hard_case(
    METRICS,
    plain="log10(0); min(100, NaN) is 100: a broken picture scored like an equal one",
    ours="asked for finite numbers first; equal pictures are infinite, and kept out of means",
    swept="equal, constant, 1e-8 to 1 apart, NaN, inf in one number; whole and in a region",
    told="the view is counted in `non_finite` and left out for every method",
)
@pytest.mark.parametrize("change", [0.0, 1e-8, 1e-3, 1.0, math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("everywhere", [True, False])
def test_psnr(change: float, everywhere: bool) -> None:
    other = PICTURE.astype(np.float32).copy()
    if everywhere or math.isfinite(change):
        other += np.float32(change)
    else:
        other[2, 3, 1] = change
    found = psnr(other, PICTURE)
    if not math.isfinite(change):
        assert math.isnan(found)
        region = np.zeros((24, 20), bool)
        region[10:, 10:] = True
        assert math.isnan(psnr(other, PICTURE, region)) == everywhere
    else:
        exact = np.square(other.astype(np.float64) - PICTURE).mean()
        assert found == (pytest.approx(-10 * np.log10(exact), abs=1e-9) if exact else math.inf)


@hard_case(
    METRICS,
    plain="0 / 0 of constant pictures; windows larger than the picture",
    ours="the constants of the formula; what lies outside is mirrored",
    swept="constant pictures of 0, 0.5 and 1, equal ones, sides of 1, 5 and 11 px; NaN stays NaN",
)
@pytest.mark.parametrize("side", [1, 5, 11, 24])
@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_ssim(side: int, value: float) -> None:
    flat = np.full((side, side, 3), value, np.float32)
    assert ssim(flat, flat) == pytest.approx(1.0)
    assert -1 <= ssim(flat, 1 - flat) <= 1
    assert math.isnan(ssim(np.full_like(flat, np.nan), flat))


@hard_case(
    METRICS,
    plain="a square root of a singular covariance; fewer pictures than dimensions; NaN from -1e-12",
    ours="singular values of an n x m product, at least 0",
    swept="zero features, equal sets, duplicates, 2 of 1280 dimensions, scales 1e-6 to 1e6",
)
@pytest.mark.parametrize("scale", [0.0, 1e-6, 1.0, 1e6])
@pytest.mark.parametrize("kind", ["equal", "shifted", "duplicates"])
def test_frechet_distance(scale: float, kind: str) -> None:
    rng = np.random.default_rng(1)
    a = scale * rng.standard_normal((3, 1280))
    b = {"equal": a, "shifted": a + scale, "duplicates": np.repeat(a[:1], 3, 0)}[kind]
    found = frechet_distance(a, b)
    exact = {"equal": 0.0, "shifted": 1280 * scale**2, "duplicates": None}[kind]
    assert found >= 0
    if exact is not None:
        assert found == pytest.approx(exact, rel=1e-6, abs=1e-9 * max(scale, 1e-30) ** 2 * 1280)
    else:
        assert found == pytest.approx(float(np.sum((a.mean(0) - a[0]) ** 2) + a.var(0, ddof=1).sum()), rel=1e-9)
    assert math.isfinite(kernel_distance(a, b))


@hard_case(
    METRICS,
    plain="a covariance of one row divides by 0",
    ours="refused with the count",
    swept="0 and 1 rows on either side",
    told="`a Frechet distance needs at least 2 vectors in each set; the first has 1`",
)
@pytest.mark.parametrize("rows", [0, 1])
@pytest.mark.parametrize("distance", [frechet_distance, kernel_distance])
def test_too_few_rows(rows: int, distance) -> None:
    few, enough = np.zeros((rows, 4)), np.ones((3, 4))
    for pair in ((few, enough), (enough, few)):
        with pytest.raises(ValueError, match="at least 2 vectors"):
            distance(*pair)


@hard_case(
    METRICS,
    plain="energy over an energy of 0: flat surroundings, holes of a pixel",
    ours="no ratio where there is nothing to compare with",
    swept="flat and lively pictures; holes of a pixel, a line, everything",
)
@pytest.mark.parametrize("kind", ["pixel", "line", "all"])
@pytest.mark.parametrize("flat", [True, False])
def test_ratios_of_holes(kind: str, flat: bool) -> None:
    hole = np.zeros((24, 20), bool)
    hole[{"pixel": np.s_[8:9, 8:9], "line": np.s_[8:9], "all": np.s_[:]}[kind]] = True
    picture = np.full_like(PICTURE, 0.5) if flat else PICTURE
    for found in (gradient_share(picture, picture, hole), gradient_ratio(picture, hole, ~hole)):
        assert found is None or (math.isfinite(found) and found >= 0)
    figures = opacity_figures(np.ones((24, 20), np.float32), hole)
    assert set(figures.values()) == {1.0}
