import pytest

from inpaint3d.contracts.models.artifacts import Effect, EffectPlan, FieldSpec, GridSpec
from inpaint3d.radiance.architecture import parameter_shapes, planned_spec
from inpaint3d.radiance.fields import RadianceField

SMALL = FieldSpec(
    grid=GridSpec(levels=3, coarsest=4, finest=32, log2_table=8, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    glo=4,
    glo_views=7,
)
EFFECTS = ("contraction", "exposure", "view-dependence")


def plan(*on: str) -> EffectPlan:
    states = {name: "on" if name in on else "off" for name in EFFECTS}
    effects = [Effect.model_validate({"name": n, "state": s, "evidence": {}, "reason": ""}) for n, s in states.items()]
    return EffectPlan(effects=tuple(effects))


def planned(*on: str) -> FieldSpec:
    return planned_spec(SMALL, plan(*on), views=5, centre_depth=0.8, near_share=0.1, bound=2.0)


@pytest.mark.parametrize(
    "update",
    [
        {},
        {"glo": 0},
        {"view_layers": 0},
        {"view_layers": 1, "bottleneck": 3},
        {"sampler": "density-grid", "density_cells": 6},
    ],
)
def test_shapes_are_those_of_the_field(update: dict[str, int | str]) -> None:
    spec = SMALL.model_copy(update=update)
    state = RadianceField(spec, seed=0).state_dict()
    assert {name: tuple(tensor.shape) for name, tensor in state.items()} == parameter_shapes(spec)


def test_what_the_plan_switches_off_has_no_weights() -> None:
    everything, nothing = parameter_shapes(planned(*EFFECTS)), parameter_shapes(planned())
    assert everything["codes"] == (5, 4)
    assert everything.keys() - nothing.keys() == {"codes", "code_map", "specular.0", "specular.1", "specular.2"}
    # three colours and a density are left
    assert nothing["base.weights.1"][0] == 4


def test_rays_of_a_bounded_scene_pass_the_whole_cube() -> None:
    spec = planned("exposure")
    assert not spec.contraction
    assert spec.far >= 1 + 2.0 * 3**0.5
    assert planned("contraction").far == SMALL.far
    assert spec.near == pytest.approx(0.08)
