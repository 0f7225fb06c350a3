"""Parameters of scene analysis: decisions taken out of its hands, and whether costs are measured."""

from typing import Annotated

from pydantic import AfterValidator, Field, WithJsonSchema

from inpaint3d.contracts.models.base import Closed
from inpaint3d.scene.effects import decided_in, load

NAMES = decided_in("scene-analysis")


def _check_forced(forced: dict[str, bool]) -> dict[str, bool]:
    for name, on in forced.items():
        if name not in NAMES:
            raise ValueError(f"no effect {name} is decided here; there are {', '.join(NAMES)}")
        if on and load(name).EFFECT.simulated_by is None:
            raise ValueError(f"{name} cannot be switched on: it is noticed, and no code simulates it (docs/effects.md)")
    return forced


Forced = Annotated[
    dict[str, bool],
    AfterValidator(_check_forced),
    WithJsonSchema(
        {"type": "object", "propertyNames": {"enum": list(NAMES)}, "additionalProperties": {"type": "boolean"}}
    ),
]


class Config(Closed):
    """What overrules what is measured. An effect's thresholds lie in its module below `scene/effects`."""

    force: Forced = Field(
        default={}, description="effects switched on or off by hand, e.g. {exposure: on, view-dependence: off}"
    )
    probe_steps: Annotated[int, Field(ge=0)] = Field(
        default=6,
        description="steps of a field that the time of each effect is measured over; 0: costs are not measured",
    )
