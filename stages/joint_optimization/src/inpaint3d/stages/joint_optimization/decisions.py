"""What the optimisation decides before it starts: the field's architecture, and the effects that need the mask."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.artifacts import EffectPlan, FieldSpec, GridSpec, PosedCapture
from inpaint3d.radiance.architecture import planned_spec
from inpaint3d.stages.joint_optimization.config import Architecture

Points = NDArray[np.float32]

# Share in percent of the points that the cube of a bounded scene holds, and its margin: outliers must not blow it up.
POINTS_INSIDE, CUBE_MARGIN = 99.0, 1.1


@dataclass(frozen=True)
class Decisions:
    """spec: the field to optimise; diffuse_start: the prior sees diffuse colour first (S10); reasons: in words."""

    spec: FieldSpec
    diffuse_start: bool
    reasons: dict[str, str]


def decide(spec: FieldSpec, plan: EffectPlan, *, carried_over: bool, distils: bool, diffuse_start: bool) -> Decisions:
    """Which effects are on, and why.

    spec: of the field. carried_over: it came with an initial field. distils: a prior is used. diffuse_start: what the
    parameters ask for (S10); without view-dependent colour there is nothing to anneal.
    """
    named = {e.name: e.reason for e in plan.effects}
    effects = {
        "contraction": spec.contraction,
        "exposure": spec.glo > 0,
        "view-dependence": spec.view_layers > 0,
    }
    reasons = {}
    for name, on in effects.items():
        source = "as in the initial field" if carried_over else named.get(name, "the effect-plan does not name it")
        reasons[name] = f"{'on' if on else 'off'}: {source}"
    start = distils and diffuse_start and spec.view_layers > 0
    if start:
        why = "on: the prior sees diffuse colour first, the rest is blended in over the first half of the schedule"
    elif not distils:
        why = "off: no prior is used"
    elif not spec.view_layers:
        why = "off: the field has no view-dependent colour"
    else:
        why = "off: by parameter"
    return Decisions(spec, start, reasons | {"diffuse-only-start": why})


def architecture_of(size: Architecture, plan: EffectPlan, posed: PosedCapture, points: Points) -> FieldSpec:
    """The spec of a fresh field: `size` with what the plan switches off left out.

    points [p, 3]: sparse points outside every mask; they bound the scene where it is not contracted.
    """
    largest = FieldSpec(
        grid=GridSpec(
            levels=size.levels,
            coarsest=size.coarsest,
            finest=size.finest,
            log2_table=size.log2_table,
            channels=size.channels,
        ),
        proposal_grid=GridSpec(
            levels=size.proposal_levels,
            coarsest=size.coarsest,
            finest=size.proposal_finest,
            log2_table=size.proposal_log2_table,
            channels=1,
        ),
        proposal_samples=size.proposal_samples,
        samples=size.samples,
        density_width=size.density_width,
        bottleneck=size.bottleneck,
        view_width=size.view_width,
        view_layers=size.view_layers,
        glo=size.glo,
        far=size.far,
    )
    reach = float(np.percentile(np.abs(points).max(-1), POINTS_INSIDE)) if len(points) else 1.0
    return planned_spec(
        largest,
        plan,
        views=sum(f.split == "train" for f in posed.frames),
        centre_depth=posed.centre_depth,
        near_share=size.near_share,
        bound=CUBE_MARGIN * max(1.0, reach),
    )
