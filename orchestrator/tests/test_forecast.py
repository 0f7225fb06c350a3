import pytest

from inpaint3d.orchestrator.forecast import find_knee, fit_power_law, forecast_gain


def law(x: float) -> float:
    return 28.0 - 20.0 * x**-0.5


def test_a_power_law_is_found_again():
    found = fit_power_law([(float(x), law(x)) for x in range(10, 200, 10)])
    # the exponents tried lie 20 % apart
    assert found.exponent == pytest.approx(0.5, rel=0.2)
    assert found.at(400) == pytest.approx(law(400), abs=0.1)


def test_the_gain_ahead_is_the_laws_and_noise_widens_its_interval():
    exact = [(float(x), law(x)) for x in range(10, 200, 10)]
    noisy = [(x, y + (0.3 if i % 2 else -0.3)) for i, (x, y) in enumerate(exact)]
    truth = law(380) - law(190)
    sure, unsure = forecast_gain(exact, 190), forecast_gain(noisy, 190)
    assert sure.value == pytest.approx(truth, abs=0.1)
    assert sure.low <= sure.value <= sure.high
    assert unsure.low < truth < unsure.high
    assert unsure.high - unsure.low > 3 * (sure.high - sure.low)


@pytest.mark.parametrize("points", [[], [(0.0, 1.0)] * 9, [(float(x), 1.0) for x in range(1, 5)]])
def test_too_few_scores_tell_nothing(points):
    assert forecast_gain(points, 10.0) is None


def test_a_flat_curve_promises_nothing():
    gain = forecast_gain([(float(x), 25.0) for x in range(1, 9)], 8.0)
    assert (gain.low, gain.value, gain.high) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_the_knee_is_where_a_broken_line_breaks():
    points = [(0.0, 0.0), (1.0, 8.0), (2.0, 16.0), (6.0, 17.0), (10.0, 18.0)]
    assert find_knee(points) == 2


@pytest.mark.parametrize("values", [[0, 1, 2, 3], [3, 2, 1, 0], [0, 1, 4, 9], [1, 2]])
def test_a_line_a_fall_and_a_curve_that_bends_upwards_have_no_knee(values):
    assert find_knee([(float(x), float(y)) for x, y in enumerate(values)]) is None
