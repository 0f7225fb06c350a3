"""Which capture effects a scene calls for; what is off is absent from the computation."""

from typing import Literal

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Finite

EffectName = Literal["contraction", "lens-distortion", "exposure", "view-dependence"]


class Effect(Closed):
    """One decision with its evidence. `forced-on` and `forced-off` come from a parameter."""

    name: EffectName
    state: Literal["on", "off", "forced-on", "forced-off"]
    evidence: dict[str, Finite] = Field(description="measured figures, by name")
    reason: str
    cost_ratio: Finite = Field(description="estimated time with the effect over without")

    @property
    def active(self) -> bool:
        return self.state in ("on", "forced-on")


class EffectPlan(Closed):
    """The decisions for one capture."""

    effects: tuple[Effect, ...]

    def active(self, name: EffectName) -> bool:
        """Whether the effect is to be simulated; an effect that the plan does not name is off."""
        return any(e.active for e in self.effects if e.name == name)
