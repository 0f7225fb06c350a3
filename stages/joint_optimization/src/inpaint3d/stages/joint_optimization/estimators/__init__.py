"""What fills the hole: one module for each estimator, with its parameters, the ports it reads, its cost and its guide.

A module added to this package is an estimator more: nothing lists them.
"""

import functools
import importlib
import operator
import pkgutil
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Field
from pydantic.config import JsonDict

from inpaint3d.stages.joint_optimization.estimators.base import Estimator


def _find_estimators() -> dict[str, type[Estimator]]:
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    found: dict[str, type[Estimator]] = {}
    waiting = [Estimator]
    while waiting:
        waiting += (kind := waiting.pop()).__subclasses__()
        if (name := kind.model_fields.get("name")) is not None:
            found[name.default] = kind
    return dict(sorted(found.items()))


def _name_estimator(given: Any) -> Any:
    return {"name": given} if isinstance(given, str) else given


ESTIMATORS = _find_estimators()
"""Name -> its class, which is the model of its parameters too."""

READS: JsonDict = {name: list(kind.reads) for name, kind in ESTIMATORS.items()}
"""The optional ports that each reads; a|b: the first that is wired."""

if TYPE_CHECKING:
    AnyEstimator = Estimator
else:
    AnyEstimator = Annotated[
        functools.reduce(operator.or_, ESTIMATORS.values()),
        Field(discriminator="name"),
        BeforeValidator(_name_estimator),
    ]
