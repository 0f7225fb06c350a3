"""Pixels that are no evidence of the scene, as effects that are on say: what passed by, frames that are blurred."""

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from inpaint3d.contracts.models.artifacts import EffectPlan
from inpaint3d.contracts.models.artifacts.effects import IgnoredFrame
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Mask, read_mask, write_mask


class PlanFolder(Protocol):
    """An effect plan's artifact."""

    @property
    def metadata(self) -> EffectPlan: ...
    @property
    def root(self) -> Path: ...


class IgnoredPixels:
    """By view, what no fit may look at. Without any, views stay as they are: nothing is read.

    whole_frames: whether frames that are left out altogether count; who completes pictures one by one needs theirs.
    """

    def __init__(self, plan: PlanFolder | None, *, whole_frames: bool = True) -> None:
        self._root = plan.root if plan else Path()
        self._by_view: dict[str, list[IgnoredFrame]] = {}
        for one in plan.metadata.ignored if plan else ():
            if whole_frames or one.mask is not None:
                self._by_view.setdefault(one.name, []).append(one)

    def take_from(self, known: Mask, name: str, camera: Camera) -> Mask:
        """The pixels [h, w] of a view that are known, without those that are no evidence."""
        for one in self._by_view.get(name, ()):
            if one.mask is None:
                return np.zeros_like(known)
            known = known & ~read_mask(self._root / one.mask, (camera.width, camera.height))
        return known


def write_ignored(folder: Path, effect: str, masks: Mapping[str, Mask]) -> list[IgnoredFrame]:
    """Write masks [h, w] of views below an effect plan's folder; returns their records."""
    records: list[IgnoredFrame] = []
    for name, mask in masks.items():
        write_mask(folder / "ignored" / f"{name}.png", mask)
        records.append(IgnoredFrame(name=name, effect=effect, mask=f"ignored/{name}.png"))
    return records
