"""Each row of the conformance list, as numbers that a wrong reading would miss."""

import math

import pytest

from inpaint3d.stages.joint_optimization.schedule import (
    centre_views_only,
    distillation_weight,
    specular_scale,
    terms_due,
    timestep_range,
    window_span,
)


def test_weight_rises_from_nothing_over_a_hundred_steps_and_stays() -> None:
    """S6: 0 -> 0.1 linearly over 100 steps counted from the start of distillation, then fixed."""
    weight = [distillation_weight(k, 1400, peak=0.1) for k in range(1400)]
    assert weight[0] == 0.0
    assert weight[1] == pytest.approx(0.001)
    assert weight[50] == pytest.approx(0.05)
    assert weight[99] < 0.1
    assert {round(w, 12) for w in weight[100:]} == {0.1}


def test_weight_is_zero_before_distillation_starts() -> None:
    assert distillation_weight(-1, 100, peak=0.1) == 0.0
    assert distillation_weight(-200, 100, peak=0.1, warmup=0) == 0.0


def test_weight_of_the_spin_nerf_settings_falls_to_a_quarter() -> None:
    """S13: 2.0 with cosine decay to a quarter of the peak."""
    weight = [distillation_weight(k, 800, peak=2.0, warmup=0, decay_to=0.25) for k in (0, 400, 800, 900)]
    assert weight == pytest.approx([2.0, 2.0 * (0.25 + 0.75 / 2), 0.5, 0.5])
    quarter = distillation_weight(200, 800, peak=2.0, warmup=0, decay_to=0.25)
    assert quarter == pytest.approx(2.0 * (0.25 + 0.75 * 0.5 * (1 + math.cos(math.pi / 4))))


def test_timesteps_anneal_on_the_global_step() -> None:
    """S9: eta = max(0.2, 0.95 (1 - s / S)), t ~ U(eta - 0.2, eta)."""
    assert timestep_range(0, 2200) == pytest.approx((0.75, 0.95, False))
    assert timestep_range(200, 2200)[:2] == pytest.approx((0.95 * 10 / 11 - 0.2, 0.95 * 10 / 11))
    assert timestep_range(1100, 2200)[:2] == pytest.approx((0.275, 0.475))
    # The paper stops at 1600 of S = 2200: eta is then 0.259, not yet at its own floor.
    assert timestep_range(1600, 2200).high == pytest.approx(0.95 * 600 / 2200)


def test_timesteps_are_floored_and_say_so() -> None:
    low, high, floored = timestep_range(2199, 2200)
    assert (low, high, floored) == (0.02, 0.2, True)
    # 0.95 (1 - s / S) < 0.22 is where the floor begins to act.
    first = next(s for s in range(2200) if timestep_range(s, 2200).floored)
    assert 0.95 * (1 - first / 2200) < 0.22 <= 0.95 * (1 - (first - 1) / 2200)


def test_diffuse_only_start_anneals_over_the_first_half() -> None:
    """S10."""
    assert [specular_scale(s, 1000) for s in (0, 250, 500, 999)] == [0.0, 0.5, 1.0, 1.0]


def test_centre_views_are_counted_from_the_start_of_distillation() -> None:
    """S8: 50 steps from the start of distillation; on the global step a warm-up of 200 would swallow them."""
    warmup = 200
    centred = [s for s in range(400) if centre_views_only(s - warmup)]
    assert centred == list(range(200, 250))


def test_window_narrows_geometrically() -> None:
    spans = [window_span(k, 101, first=0.8, last=0.2) for k in (0, 50, 100, 500)]
    assert spans == pytest.approx([0.8, 0.4, 0.2, 0.2])
    assert window_span(0, 1, first=0.7, last=0.3) == 0.7


def test_gradients_are_measured_on_steps_that_distil() -> None:
    """L8: with every second step distilled, a plain multiple of 50 would never meet one."""
    due = [s for s in range(400) if terms_due(s, s, 50, 2)]
    assert len(due) == 7
    assert all(s % 2 == 0 for s in due)
    assert [s + 1 for s in range(20) if terms_due(s, s - 2, 4, 1)] == [4, 8, 12, 16, 20]
    assert [s + 1 for s in range(200) if terms_due(s, -1, 50, 2)] == [50, 100, 150, 200]
