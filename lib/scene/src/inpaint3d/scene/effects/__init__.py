"""What a capture may call for: one module per effect, all alike (`description`), listed here and nowhere else.

Imports nothing: command lines ask for names. `load(name)` imports an effect's module.
"""

import importlib
from types import ModuleType

DECIDED_IN = {
    "lens-distortion": "pose-estimation",
    "exposure": "scene-analysis",
    "vignetting": "scene-analysis",
    "view-dependence": "scene-analysis",
    "contraction": "scene-analysis",
    "transients": "scene-analysis",
    "blur": "scene-analysis",
    "rolling-shutter": "scene-analysis",
    "anti-aliasing": "scene-analysis",
    "diffuse-only-start": "joint-optimization",
    "depth-smoothness": "joint-optimization",
    "prior": "view-completion",
}
"""Effect -> the stage that decides it."""


def load(name: str) -> ModuleType:
    """The module of an effect; KeyError for a name that there is not."""
    if name not in DECIDED_IN:
        raise KeyError(name)
    return importlib.import_module(f"{__name__}.{name.replace('-', '_')}")


def decided_in(stage: str) -> tuple[str, ...]:
    """The effects that a stage decides."""
    return tuple(name for name, decider in DECIDED_IN.items() if decider == stage)
