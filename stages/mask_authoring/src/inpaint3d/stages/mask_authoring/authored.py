"""A mask for every view, however it was made, and its way into an artifact."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import MaskSet, MaskView, NamedMask, Primitive, ViewOrder
from inpaint3d.contracts.models.artifacts.mask_sets import Origin
from inpaint3d.scene.image_io import write_mask
from inpaint3d.stages.mask_authoring.consistency import Agreement

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class NamedMasks:
    """One of several objects: bool [h, w] for each posed view, and whether it is taken out."""

    name: str
    removed: bool
    masks: list[Bools]


@dataclass(frozen=True, eq=False)
class Authored:
    """Masks bool [h, w] in the posed views and in the truth cameras, and how they came about."""

    origin: Origin
    method: str
    masks: list[Bools]
    truth_masks: list[Bools]
    primitives: tuple[Primitive, ...] = field(default=())
    objects: tuple[NamedMasks, ...] = field(default=())
    occlusion: tuple[ViewOrder, ...] = field(default=())

    @property
    def mean_share(self) -> float:
        """Of the views' pixels, how many are in the hole."""
        return float(np.mean([m.mean() for m in self.masks]))


@dataclass(frozen=True, eq=False)
class Names:
    """Of the posed views and of the truth cameras, in the masks' order."""

    views: Sequence[str]
    truth: Sequence[str] = ()


def write_mask_set(
    folder: Path,
    authored: Authored,
    names: Names,
    agreement: Agreement | None = None,
    unseen: Sequence[Bools] | None = None,
) -> MaskSet:
    """Write every mask below `folder`; returns the artifact's metadata.

    agreement: how well the views' masks agree; None for volumes. unseen: what of each view's mask no other view shows.
    """
    confidences = agreement.views if agreement else [None] * len(names.views)
    views = [
        view.model_copy(update={"confidence": confidence})
        for view, confidence in zip(_write(folder, "masks", names.views, authored.masks), confidences, strict=True)
    ]
    if unseen is not None:
        smaller = _write(folder, "unseen", names.views, unseen)
        views = [v.model_copy(update={"unseen": s.mask}) for v, s in zip(views, smaller, strict=True)]
    return MaskSet(
        kind="volume" if authored.primitives else "per-view",
        task="outpaint" if authored.origin == "outpaint" else "inpaint",
        origin=authored.origin,
        method=authored.method,
        primitives=authored.primitives,
        views=tuple(views),
        truth_views=_write(folder, "truth_masks", names.truth, authored.truth_masks),
        consistency=agreement.set if agreement else None,
        views_to_check=agreement.to_check(names.views) if agreement else (),
        objects=tuple(
            NamedMask(
                name=one.name,
                removed=one.removed,
                views=_write(folder, f"objects/{one.name}/masks", names.views, one.masks),
            )
            for one in authored.objects
        ),
        occlusion=authored.occlusion,
    )


def _write(folder: Path, below: str, names: Sequence[str], masks: Sequence[Bools]) -> tuple[MaskView, ...]:
    records = []
    for name, mask in zip(names, masks, strict=True):
        path = f"{below}/{name}.png"
        write_mask(folder / path, mask)
        records.append(MaskView(name=name, mask=path, share=float(mask.mean())))
    return tuple(records)
