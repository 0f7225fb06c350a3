"""A mask for every view, however it was made, and its way into an artifact."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import MaskSet, MaskView, Primitive
from inpaint3d.scene.image_io import write_mask

Bools = NDArray[np.bool_]
Origin = Literal["sphere", "box", "object", "scribble", "outpaint", "imported"]


@dataclass(frozen=True, eq=False)
class Authored:
    """Masks bool [h, w] in the posed views and in the truth cameras, and how they came about."""

    origin: Origin
    method: str
    masks: list[Bools]
    truth_masks: list[Bools]
    primitives: tuple[Primitive, ...] = field(default=())

    @property
    def mean_share(self) -> float:
        """Of the views' pixels, how many are in the hole."""
        return float(np.mean([m.mean() for m in self.masks]))


def write_mask_set(
    folder: Path, authored: Authored, names: Sequence[str], truth_names: Sequence[str], consistency: float | None
) -> MaskSet:
    """Write every mask below `folder`; returns the artifact's metadata."""
    return MaskSet(
        kind="volume" if authored.primitives else "per-view",
        task="outpaint" if authored.origin == "outpaint" else "inpaint",
        origin=authored.origin,
        method=authored.method,
        primitives=authored.primitives,
        views=_write(folder, "masks", names, authored.masks),
        truth_views=_write(folder, "truth_masks", truth_names, authored.truth_masks),
        consistency=consistency,
    )


def _write(folder: Path, below: str, names: Sequence[str], masks: list[Bools]) -> tuple[MaskView, ...]:
    records = []
    for name, mask in zip(names, masks, strict=True):
        path = f"{below}/{name}.png"
        write_mask(folder / path, mask)
        records.append(MaskView(name=name, mask=path, share=float(mask.mean())))
    return tuple(records)
