"""The effect plan as a page tells it. This is the one place that reads its model."""

from collections.abc import Sequence
from dataclasses import dataclass

from inpaint3d.contracts.models.artifacts import EffectPlan


@dataclass(frozen=True)
class EffectRow:
    """One effect: whether the capture calls for it, in which words, on what evidence, at what cost."""

    name: str
    called_for: bool
    reason: str
    evidence: str
    cost: str


def describe_effects(plan: EffectPlan) -> Sequence[EffectRow]:
    """What is simulated first, then what is not."""
    rows = [
        EffectRow(
            name=effect.name.replace("-", " "),
            called_for=effect.active,
            reason=f"by parameter: {effect.reason}" if effect.state.startswith("forced") else effect.reason,
            evidence="; ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in effect.evidence.items()),
            cost=f"{effect.cost_ratio:.2f} ×",
        )
        for effect in plan.effects
    ]
    return sorted(rows, key=lambda row: not row.called_for)
