"""Choosing a few of many."""

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


def choose_evenly(items: Sequence[T], count: int) -> list[T]:
    """At most `count` items, spread evenly over the sequence; both ends are among them, or the middle is the only one.

    Three of ten are the first, the fifth and the last.
    """
    if count >= len(items):
        return list(items)
    if count <= 1:
        return [items[len(items) // 2]] if count == 1 else []
    return [items[round(i * (len(items) - 1) / (count - 1))] for i in range(count)]
