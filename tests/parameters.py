"""Parameters of a stage in tests: groups are merged, so that a test names only what it changes."""

from typing import Any


def merge(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`base` with `changes` over it, group by group; another estimator or method starts from its own defaults."""
    merged = dict(base)
    for name, value in changes.items():
        before = merged.get(name)
        groups = isinstance(before, dict) and isinstance(value, dict)
        same = groups and value.get("name", before.get("name")) == before.get("name")
        merged[name] = merge(before, value) if same else value
    return merged
