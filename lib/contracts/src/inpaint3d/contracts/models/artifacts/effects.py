"""Which capture effects a scene calls for; what is off is absent from the computation."""

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from inpaint3d.contracts.models.base import Closed, Finite, FrameName, RelativePath

EffectName = Annotated[
    str,
    Field(description="as `scene.effects.DECIDED_IN` lists it"),
    StringConstraints(pattern=r"^[a-z][a-z0-9-]*$"),
]


class Interval(Closed):
    """A measured figure with its 95 % confidence interval."""

    value: Finite
    low: Finite
    high: Finite
    unit: str = ""


class Effect(Closed):
    """One decision with its evidence. `forced-on`, `forced-off`: by hand; `noticed`: nothing simulates it."""

    name: EffectName
    state: Literal["on", "off", "forced-on", "forced-off", "noticed"]
    size: Interval | None = Field(default=None, description="how strong it is; None: the capture is too small to tell")
    gain: Interval | None = Field(
        default=None,
        description="what it explains of data that were held out, or of a penalised likelihood; above 0: for it",
    )
    material: Finite = Field(default=0.0, description="sizes up to this one are left alone, in the size's unit")
    least_gain: Finite = Field(default=0.0, description="gains up to this one are left alone")
    evidence: dict[str, Finite] = Field(description="measured figures, by name")
    series: dict[str, tuple[Finite, ...]] = Field(default={}, description="figures by frame, in the frames' order")
    reason: str
    simulated_by: str | None = Field(
        default=None, description="name of the code that is there when the effect is on; None: no code simulates it"
    )

    @property
    def active(self) -> bool:
        return self.state in ("on", "forced-on")


class IgnoredFrame(Closed):
    """Pixels of a frame that are no evidence of the scene."""

    name: FrameName
    effect: EffectName
    mask: RelativePath | None = Field(
        default=None, description="ignored/NAME.png, 8-bit, > 127 where a pixel is no evidence; None: all of the frame"
    )


class EffectPlan(Closed):
    """The decisions for one capture."""

    effects: tuple[Effect, ...]
    ignored: tuple[IgnoredFrame, ...] = Field(
        default=(), description="what effects that are on take out of the evidence"
    )

    def active(self, name: str) -> bool:
        """Whether the effect is to be simulated; an effect that the plan does not name is off."""
        return any(e.active for e in self.effects if e.name == name)
