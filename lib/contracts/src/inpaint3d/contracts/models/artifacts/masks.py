"""A mask in 3D: what was asked for, and what every view got."""

from typing import Annotated, Literal

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Finite, FrameName, Positive, RelativePath, Share, Vector3

Pixel = tuple[Finite, Finite]


class SphereRequest(Closed):
    """A sphere on the centre camera's optical axis (M1), or at a point given in scene units."""

    kind: Literal["sphere"]
    centre: Vector3 | None = Field(default=None, description="scene units; None: on the centre camera's axis")
    distance: Positive = Field(default=1.0, description="along the axis, as a fraction of the median depth there")
    radius: Positive = Field(
        default=0.25, description="as a fraction of the median depth (of scene units with `centre`)"
    )


class BoxRequest(Closed):
    """An axis-aligned box in scene units, turned about z by `yaw_deg`."""

    kind: Literal["box"]
    centre: Vector3
    size: tuple[Positive, Positive, Positive]
    yaw_deg: Finite = 0.0


class ObjectRequest(Closed):
    """An object pointed at on one view (M2): pixels on it, pixels off it, or a box around it."""

    kind: Literal["object"]
    view: FrameName
    points: tuple[Pixel, ...] = Field(default=(), description="pixels on the object, in the captured frame")
    background: tuple[Pixel, ...] = Field(default=(), description="pixels not on the object")
    box: tuple[Finite, Finite, Finite, Finite] | None = Field(default=None, description="x0, y0, x1, y1")
    frame_size: tuple[int, int] | None = Field(
        default=None,
        description="width, height of the picture the pixels were read on; None: the posed frame",
    )


class ScribbleRequest(Closed):
    """A path drawn on one view (M3), or a random one where `path` is empty."""

    kind: Literal["scribble"]
    view: FrameName
    path: tuple[Pixel, ...] = ()
    frame_size: tuple[int, int] | None = None
    thickness: Share = Field(default=0.05, description="of the shorter side")


class OutpaintRequest(Closed):
    """The inverted sphere (M4): everything outside it is to be made up."""

    kind: Literal["outpaint"]
    distance: Positive = 1.0
    radius: Positive = 0.6


class ImportedRequest(Closed):
    """Use the masks that came with the capture."""

    kind: Literal["imported"]


class MaskRequest(Closed):
    """What the user asks for: `--mask REQUEST.yaml`."""

    mask: Annotated[
        SphereRequest | BoxRequest | ObjectRequest | ScribbleRequest | OutpaintRequest | ImportedRequest,
        Field(discriminator="kind"),
    ]
    dilate: Share = Field(default=0.015, description="grown by this share of the shorter side after closing")


class Primitive(Closed):
    """A volume in scene units; `inverted`: the hole is outside it."""

    kind: Literal["sphere", "box"]
    centre: Vector3
    size: tuple[Positive, Positive, Positive] = Field(description="sphere: diameter three times; box: full sides")
    yaw_deg: Finite = 0.0
    inverted: bool = False


class MaskView(Closed):
    """The mask in one view (8-bit PNG, > 127 inside the hole), same size as the posed frame."""

    name: FrameName
    mask: RelativePath = Field(description="masks/NAME.png")
    confidence: RelativePath | None = Field(default=None, description="confidence/NAME.png, 8-bit, 255 = certain")
    share: Share = Field(description="share of the view inside the hole")


class MaskSet(Closed):
    """One mask per posed frame, and in the truth cameras for evaluation only (`truth_masks/`)."""

    kind: Literal["volume", "per-view"]
    task: Literal["inpaint", "outpaint"]
    origin: Literal["sphere", "box", "object", "scribble", "outpaint", "imported"]
    method: str = Field(description="how it was made, e.g. 'grabcut seeded by points, reprojected with field depth'")
    primitives: tuple[Primitive, ...] = ()
    views: tuple[MaskView, ...]
    truth_views: tuple[MaskView, ...] = Field(default=(), description="evaluation only; never read by training")
    consistency: Share | None = Field(
        default=None, description="mean IoU of each view's mask with its neighbour's mask reprojected into it"
    )
