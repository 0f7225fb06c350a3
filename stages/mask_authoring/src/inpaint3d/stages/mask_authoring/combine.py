"""Masks put together of others: unions, differences, and several objects with names."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts.mask_sets import ViewOrder
from inpaint3d.contracts.models.artifacts.masks import DifferenceRequest, ObjectsRequest, Part, UnionRequest
from inpaint3d.stages.mask_authoring.authored import Authored, NamedMasks
from inpaint3d.stages.mask_authoring.segment import middle_depth
from inpaint3d.stages.mask_authoring.views import DepthView

Bools = NDArray[np.bool_]
Author = Callable[[Part, float], Authored]
"""Makes the masks of a part, grown by a share of the shorter side."""


def author_union(request: UnionRequest, make: Author, dilate: float) -> Authored:
    """What any of the parts masks."""
    parts = [make(part, dilate) for part in request.of]
    together = _unite(parts)
    return Authored(
        origin="union",
        method=" + ".join(f"({part.method})" for part in parts),
        masks=together.masks,
        truth_masks=together.truth_masks,
        primitives=together.primitives,
    )


def author_difference(request: DifferenceRequest, make: Author, dilate: float) -> Authored:
    """A mask, grown, without what others mask, which are not: what is to stay keeps its outline."""
    whole, kept = make(request.of, dilate), _unite([make(part, 0.0) for part in request.minus])
    return Authored(
        origin="difference",
        method=f"({whole.method}) without ({kept.method})",
        masks=_without(whole.masks, kept.masks),
        truth_masks=_without(whole.truth_masks, kept.truth_masks),
    )


def author_objects(request: ObjectsRequest, make: Author, dilate: float, views: Sequence[DepthView]) -> Authored:
    """Every object's own masks; those that are removed, together."""
    found = {name: make(part, dilate) for name, part in request.named.items()}
    removed = tuple(found) if request.remove is None else request.remove
    together = _unite([found[name] for name in removed])
    return Authored(
        origin="objects",
        method="; ".join(f"{name}: {found[name].method}" for name in removed),
        masks=together.masks,
        truth_masks=together.truth_masks,
        primitives=together.primitives,
        objects=tuple(NamedMasks(name, name in removed, one.masks) for name, one in found.items()),
        occlusion=order_by_depth({name: one.masks for name, one in found.items()}, views),
    )


def order_by_depth(masks: dict[str, list[Bools]], views: Sequence[DepthView]) -> tuple[ViewOrder, ...]:
    """For each view the objects that it shows, the nearest first, by the median depth under their masks."""
    orders: list[ViewOrder] = []
    for i, view in enumerate(views):
        depth = view.depth_at(view.camera.pixel_centres())
        shown = {name: middle_depth(depth[own[i]]) for name, own in masks.items()}
        known = {name: z for name, z in shown.items() if z is not None}
        orders.append(ViewOrder(name=view.name, front_to_back=tuple(sorted(known, key=known.__getitem__))))
    return tuple(orders)


def _unite(parts: Sequence[Authored]) -> Authored:
    """All parts as one; a volume where every part is one."""
    first = parts[0]
    volumes = all(part.primitives for part in parts)
    return Authored(
        origin=first.origin,
        method=", ".join(part.method for part in parts),
        masks=[np.logical_or.reduce(views) for views in zip(*(p.masks for p in parts), strict=True)],
        truth_masks=[np.logical_or.reduce(views) for views in zip(*(p.truth_masks for p in parts), strict=True)],
        primitives=tuple(one for part in parts for one in part.primitives) if volumes else (),
    )


def _without(masks: list[Bools], others: list[Bools]) -> list[Bools]:
    return [mask & ~other for mask, other in zip(masks, others, strict=True)]
