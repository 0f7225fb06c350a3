"""A mask in 3D: what every view got. What was asked for is in `masks`."""

from typing import Literal

from pydantic import Field

from inpaint3d.contracts.models.artifacts.masks import ObjectName
from inpaint3d.contracts.models.base import Closed, Finite, FrameName, Positive, RelativePath, Share, Vector3

Origin = Literal[
    "sphere", "box", "object", "scribble", "outpaint", "imported", "union", "difference", "objects"
]  # fmt: skip


class Primitive(Closed):
    """A volume in scene units; `inverted`: the hole is outside it."""

    kind: Literal["sphere", "box"]
    centre: Vector3
    size: tuple[Positive, Positive, Positive] = Field(description="sphere: diameter three times; box: full sides")
    yaw_deg: Finite = 0.0
    inverted: bool = False


class MaskView(Closed):
    """The mask in one view (8-bit PNG, > 127 inside the hole), same size as the posed frame.

    A view that does not show what is masked has an empty mask (share 0): it is known whole. A full one (share 1) leaves
    nothing known of its view; the other views still count.
    """

    name: FrameName
    mask: RelativePath = Field(description="masks/NAME.png")
    unseen: RelativePath | None = Field(
        default=None,
        description="unseen/NAME.png: what of the mask no other view shows either; None where it was not looked for",
    )
    confidence: Share | None = Field(
        default=None,
        description="mean IoU with the masks of the nearest views, carried over by depth; None: a volume, or not seen",
    )
    share: Share = Field(description="share of the view inside the hole")


class NamedMask(Closed):
    """One of several objects: its own mask in every view, grown as the set's."""

    name: ObjectName
    removed: bool = Field(description="it is part of the set's masks")
    views: tuple[MaskView, ...] = Field(description="objects/NAME/masks/FRAME.png")


class ViewOrder(Closed):
    """Which of several objects stands before which in one view."""

    name: FrameName
    front_to_back: tuple[ObjectName, ...] = Field(description="by median depth; those that the view shows")


class PlaneShadow(Closed):
    """What an object does to the light on a plane that it touches, and what the same search finds by chance.

    `log_likelihood`: how much better its shadow explains differences of brightness between places of one material than
    no shadow does. Chance: the most that is found where the same object is thought at other places of the plane.
    """

    normal: Vector3
    offset: Finite = Field(description="of the plane, scene units: normal . x = offset")
    found: bool = Field(description="the masks are grown by it")
    darkest: Share = Field(description="of its light that a place which some view shows is kept from, at most")
    threshold: Share = Field(description="a place is in the shadow from here on: more than chance finds")
    log_likelihood: Finite
    log_likelihood_by_chance: Finite
    picture: RelativePath = Field(description="shadows/N.png: the plane from above; the light kept from it; the shadow")
    added: dict[FrameName, Share] = Field(description="by view, the share of the view that the shadow adds to its mask")


class MaskSet(Closed):
    """One mask per posed frame, and in the truth cameras for evaluation only (`truth_masks/`)."""

    kind: Literal["volume", "per-view"]
    task: Literal["inpaint", "outpaint"]
    origin: Origin
    hole: Literal["object", "unseen"] = Field(
        default="object",
        description="where a field follows completed views: all of each mask, or what of it no other shows",
    )
    method: str = Field(description="how it was made, e.g. 'grabcut seeded by points, reprojected with field depth'")
    primitives: tuple[Primitive, ...] = ()
    views: tuple[MaskView, ...]
    truth_views: tuple[MaskView, ...] = Field(default=(), description="evaluation only; never read by training")
    consistency: Share | None = Field(
        default=None, description="mean IoU of each view's mask with its neighbour's mask reprojected into it"
    )
    views_to_check: tuple[FrameName, ...] = Field(
        default=(), description="views whose confidence is low: a person should look at them"
    )
    objects: tuple[NamedMask, ...] = Field(default=(), description="several objects, each with a set of its own")
    occlusion: tuple[ViewOrder, ...] = Field(default=(), description="of several objects, by view")
    shadows: tuple[PlaneShadow, ...] | None = Field(
        default=None,
        description="on planes that the object touches; None where they were not asked for",
        exclude_if=lambda looked_for: looked_for is None,
    )
