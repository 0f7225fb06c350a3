"""What the optimisation decides before it starts: the effects that need the mask, and why."""

from dataclasses import dataclass

from inpaint3d.contracts.models.artifacts import EffectPlan, FieldSpec


@dataclass(frozen=True)
class Decisions:
    """spec: the field to optimise; diffuse_start: the prior sees diffuse colour first (S10); reasons: in words."""

    spec: FieldSpec
    diffuse_start: bool
    reasons: dict[str, str]


def decide(spec: FieldSpec, plan: EffectPlan, *, warm_start: bool, distils: bool, diffuse_first: bool) -> Decisions:
    """Which effects are on, and why.

    spec: of the field. warm_start: it came with an initial field. distils: a guide pulls the hole. diffuse_first: what
    the estimator asks for (S10); without view-dependent colour there is nothing to anneal.
    """
    named = {e.name: e.reason for e in plan.effects}
    effects = {
        "contraction": spec.contraction,
        "exposure": spec.glo > 0,
        "view-dependence": spec.view_layers > 0,
    }
    reasons = {}
    for name, on in effects.items():
        source = "as in the initial field" if warm_start else named.get(name, "the effect-plan does not name it")
        reasons[name] = f"{'on' if on else 'off'}: {source}"
    start = distils and diffuse_first and spec.view_layers > 0
    if start:
        why = "on: the prior sees diffuse colour first, the rest is blended in over the first half of the schedule"
    elif not distils:
        why = "off: no prior is used"
    elif not spec.view_layers:
        why = "off: the field has no view-dependent colour"
    else:
        why = "off: by parameter"
    return Decisions(spec, start, reasons | {"diffuse-only-start": why})
