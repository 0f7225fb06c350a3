"""The effect plan as a page tells it: what the capture calls for, on what evidence, at what cost."""

from collections.abc import Sequence
from dataclasses import dataclass

from inpaint3d.contracts.models.artifacts.effects import Effect, Interval
from inpaint3d.contracts.models.report import EffectFigures


@dataclass(frozen=True)
class EffectRow:
    """One effect: its state, in which words, on what evidence, at what cost."""

    name: str
    state: str
    reason: str
    evidence: str
    cost: str


def describe_effects(found: Sequence[EffectFigures]) -> list[EffectRow]:
    """What is simulated first, then what is not."""
    return [
        EffectRow(
            name=figures.effect.name.replace("-", " "),
            state=figures.effect.state,
            reason=figures.effect.reason,
            evidence=_describe_evidence(figures.effect),
            cost="" if figures.step_ratio is None else f"{figures.step_ratio:.2f} ×",
        )
        for figures in sorted(found, key=lambda figures: not figures.effect.active)
    ]


def _describe_evidence(effect: Effect) -> str:
    parts = [_describe_interval(what, i) for what, i in (("size", effect.size), ("gain", effect.gain)) if i is not None]
    parts += [f"{name.replace('_', ' ')} {value:.4g}" for name, value in effect.evidence.items()]
    return "; ".join(parts)


def _describe_interval(what: str, found: Interval) -> str:
    unit = f" {found.unit}" if found.unit else ""
    return f"{what} {found.value:.3g}{unit} (95 %: {found.low:.3g} to {found.high:.3g})"
