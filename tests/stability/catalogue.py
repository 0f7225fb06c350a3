"""The catalogue of hard cases: each test says what it is about, and docs/stability.md is written from that."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class HardCase:
    """One row of the catalogue.

    plain: what goes wrong in the plain formula, or without the guard. ours: what is done. swept: magnitudes of values
    and gradients. told: what a user gets, with the exit code; empty where nothing is said, since nothing goes wrong.
    """

    area: str
    plain: str
    ours: str
    swept: str
    told: str = ""


def hard_case(area: str, *, plain: str, ours: str, swept: str, told: str = "") -> Callable[[F], F]:
    """Mark a test as a row of the catalogue; each set of its parameters is a case."""

    def mark(test: F) -> F:
        setattr(test, "hard_case", HardCase(area, plain, ours, swept, told))  # noqa: B010 - a function has no such field
        return test

    return mark
