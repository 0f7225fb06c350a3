import numpy as np
import pytest
import torch

from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rays import Rays
from inpaint3d.radiance.rendering import render
from inpaint3d.stages.scene_analysis.costs import IN_FIELD, PLAIN, Probe, measure_costs, plan_of

POINTS = np.random.default_rng(0).uniform(-1, 1, (50, 3)).astype(np.float32)
OWN = {"exposure": {"codes", "code_map"}, "view-dependence": {"specular"}, "contraction": set()}


def parameters(name):
    return {key.partition(".")[0]: value for key, value in Probe(plan_of(name), POINTS, 5, 0)._field.named_parameters()}


@pytest.mark.parametrize("name", IN_FIELD)
def test_an_effect_that_is_off_has_no_parameter(name):
    assert set(parameters(name)) - set(parameters(PLAIN)) == OWN[name]


def kernels(name, tmp):
    """Names of the operations of a step, and how often each ran."""
    probe = Probe(plan_of(name), POINTS, 5, 0)
    probe.take_step()
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profile:
        probe.take_step()
    return {event.key: event.count for event in profile.key_averages()}


def test_an_effect_that_is_off_runs_no_kernel(tmp_path):
    counts = {name: kernels(name, tmp_path) for name in (PLAIN, "exposure", "view-dependence")}
    # What is on runs more operations than the plain field, and the plain field none that a field without it lacks.
    for name in ("exposure", "view-dependence"):
        assert sum(counts[name].values()) > sum(counts[PLAIN].values())
        assert set(counts[PLAIN]) <= set(counts[name])
    assert not any("index_select" in key or key == "aten::exp_" for key in set(counts[PLAIN]) - set(counts["exposure"]))


def test_the_plain_fields_colours_are_the_diffuse_ones():
    field = Probe(plan_of(PLAIN), POINTS, 5, 0)._field
    assert isinstance(field, RadianceField)
    rays = Rays(torch.zeros(4, 3), torch.nn.functional.normalize(torch.randn(4, 3), dim=-1))
    seen = render(field, rays)
    torch.testing.assert_close(seen.rgb, seen.diffuse)


def test_costs_are_ratios_to_the_plain_field():
    rows = {row["effect"]: row for row in measure_costs(POINTS, 5, 1, 1, 0)}
    assert set(rows) == {PLAIN, *IN_FIELD}
    assert rows[PLAIN]["ratio"] == 1
    assert rows[PLAIN]["bytes"] == rows["contraction"]["bytes"] == 0
    assert rows["exposure"]["bytes"] == 4 * 4 * (5 * 4 + 4 * 6)  # four codes of five views, and their map
    assert rows["view-dependence"]["bytes"] > 0


def test_no_steps_cost_nothing():
    assert list(measure_costs(POINTS, 5, 0, 1, 0)) == []
