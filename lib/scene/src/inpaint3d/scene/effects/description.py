"""The interface of an effect: what it is, what was found, and the one rule that decides.

A module of an effect has `EFFECT: Description`; where its stage measures it, also a function that returns a `Finding`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from inpaint3d.contracts.models.artifacts import Effect, Interval

Forced = Mapping[str, bool]


@dataclass(frozen=True)
class Description:
    """One row of docs/effects.md.

    material, least_gain: sizes (in `unit`) and gains up to these are left alone. simulated_by: dotted name of the code
    that is there when the effect is on, and absent when it is off; None: the effect is noticed and no code simulates
    it. parameter: what sets the effect where `--effect` cannot.
    """

    name: str
    what: str
    evidence: str
    off_means: str
    simulated_by: str | None
    material: float = 0.0
    least_gain: float = 0.0
    unit: str = ""
    criterion: str = ""
    parameter: str | None = None


@dataclass(frozen=True)
class Finding:
    """What was measured of an effect.

    size: how strong it is. gain: how much better data that were held out are explained with it (or by how much a
    penalised likelihood grows); above 0 speaks for it. Both None where the capture is too small to tell; `unknown` is
    the decision then. series: figures by view, in the views' order.
    """

    words: str
    size: Interval | None = None
    gain: Interval | None = None
    figures: dict[str, float] = field(default_factory=dict[str, float])
    series: dict[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    unknown: bool = False


def decide(effect: Description, found: Finding, forced: Forced) -> Effect:
    """The decision: on where the size is beyond `material` and the gain beyond `least_gain`, both with 95 % confidence.

    forced: effects that somebody switched by hand; what was measured is told all the same.
    """
    wanted = found.unknown
    if found.size is not None and found.gain is not None:
        wanted = found.size.low > effect.material and found.gain.low > effect.least_gain
    by_hand = forced.get(effect.name)
    reason = found.words
    if by_hand is not None:
        state, reason = ("forced-on" if by_hand else "forced-off"), f"by hand; measured: {reason}"
    elif effect.simulated_by is None:
        state = "noticed" if wanted else "off"
    else:
        state = "on" if wanted else "off"
    return Effect(
        name=effect.name,
        state=state,
        size=found.size,
        gain=found.gain,
        material=effect.material,
        least_gain=effect.least_gain,
        evidence=found.figures,
        series=found.series,
        reason=reason,
        simulated_by=effect.simulated_by,
    )
