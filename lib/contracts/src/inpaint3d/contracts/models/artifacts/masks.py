"""What a person asks to be masked: `--mask REQUEST.yaml`. Every kind can be written by hand in a few lines."""

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from inpaint3d.contracts.models.base import Closed, Finite, FrameName, Positive, Share, Vector3

Pixel = tuple[Finite, Finite]
Side = Annotated[int, Field(ge=1)]
FrameSize = Annotated[
    tuple[Side, Side] | None,
    Field(description="width, height of the picture the pixels were read on; None: the posed frame"),
]
ObjectName = Annotated[str, StringConstraints(pattern=r"^[a-z0-9][a-z0-9_-]{0,62}$")]


def check_pixels(points: tuple[Pixel, ...], size: tuple[int, int] | None, what: str) -> None:
    """ValueError for the first pixel that lies outside a picture of a known size, or left of or above any."""
    for x, y in points:
        if x < 0 or y < 0:
            raise ValueError(f"{what} [{x:g}, {y:g}] is outside the picture: pixels count from 0 at its upper left")
        if size is not None and (x >= size[0] or y >= size[1]):
            raise ValueError(f"{what} [{x:g}, {y:g}] is outside the picture of {size[0]}x{size[1]} pixels (frame_size)")


class SurfaceClick(Closed):
    """A place on a surface: the pixel of a view that shows it."""

    view: FrameName
    at: Pixel = Field(description="x, y")
    frame_size: FrameSize = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_pixels((self.at,), self.frame_size, "at")
        return self


class SphereRequest(Closed):
    """A sphere on the centre camera's optical axis (M1), at a point in scene units, or on a surface clicked at."""

    kind: Literal["sphere"]
    centre: Vector3 | None = Field(default=None, description="scene units; None: on the centre camera's axis")
    surface: SurfaceClick | None = Field(default=None, description="the sphere's centre is where this view shows it")
    distance: Positive = Field(default=1.0, description="along the axis, as a fraction of the median depth there")
    radius: Positive = Field(
        default=0.25,
        description="as a fraction of the median depth (of scene units with `centre`, of the click's depth with "
        "`surface`)",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.centre is not None and self.surface is not None:
            raise ValueError("give either `centre` or `surface`, not both")
        return self


class BoxRequest(Closed):
    """A box round a point in scene units, or round a surface clicked at, turned about z by `yaw_deg`."""

    kind: Literal["box"]
    centre: Vector3 | None = Field(default=None, description="scene units")
    surface: SurfaceClick | None = Field(default=None, description="the box's centre is where this view shows it")
    size: tuple[Positive, Positive, Positive] = Field(
        description="full sides in scene units; with `surface`, as fractions of the click's depth"
    )
    yaw_deg: Finite = 0.0

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.centre is None) == (self.surface is None):
            raise ValueError("give either `centre` in scene units or `surface`, a click on a view")
        return self


class ObjectPrompts(Closed):
    """Where an object is on one view: pixels on it, pixels off it, or a box around it."""

    view: FrameName
    points: tuple[Pixel, ...] = Field(default=(), description="pixels on the object, in the captured frame")
    background: tuple[Pixel, ...] = Field(default=(), description="pixels not on the object")
    box: tuple[Finite, Finite, Finite, Finite] | None = Field(default=None, description="x0, y0, x1, y1")
    frame_size: FrameSize = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.points and self.box is None:
            raise ValueError(f"give points on the object in view {self.view!r}, or a box round it")
        check_pixels(self.points, self.frame_size, "point")
        check_pixels(self.background, self.frame_size, "background point")
        if set(self.points) & set(self.background):
            raise ValueError(f"a pixel of view {self.view!r} is under `points` and under `background`; take one out")
        if self.box is not None:
            self._check_box(self.box)
        return self

    def _check_box(self, box: tuple[float, float, float, float]) -> None:
        x0, y0, x1, y1 = box
        if x1 <= x0 or y1 <= y0:
            raise ValueError(f"box {list(box)} is empty; it is x0, y0, x1, y1")
        check_pixels(((x0, y0),), self.frame_size, "box corner")
        if self.frame_size is not None and (x1 > self.frame_size[0] or y1 > self.frame_size[1]):
            raise ValueError(f"box {list(box)} leaves the picture of {self.frame_size[0]}x{self.frame_size[1]} pixels")
        if any(not (x0 <= x <= x1 and y0 <= y <= y1) for x, y in self.points):
            raise ValueError(f"a point lies outside the box {list(box)}; move one of them")


class ObjectRequest(ObjectPrompts):
    """An object pointed at on one view (M2), or on more of them."""

    kind: Literal["object"]
    other_views: tuple[ObjectPrompts, ...] = Field(default=(), description="the same object, pointed at on more views")

    @model_validator(mode="after")
    def _check_views(self) -> Self:
        names = [prompts.view for prompts in self.prompts]
        if len(set(names)) < len(names):
            raise ValueError(f"other_views name a view twice; there are {', '.join(names)}")
        return self

    @property
    def prompts(self) -> tuple[ObjectPrompts, ...]:
        """What was pointed at, view by view."""
        return (self, *self.other_views)


class ScribbleRequest(Closed):
    """A path drawn on one view (M3), or a random one where `path` is empty."""

    kind: Literal["scribble"]
    view: FrameName
    path: tuple[Pixel, ...] = ()
    frame_size: FrameSize = None
    thickness: Share = Field(default=0.05, description="of the shorter side")

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_pixels(self.path, self.frame_size, "path point")
        return self


class OutpaintRequest(Closed):
    """The inverted sphere (M4): everything outside it is to be made up."""

    kind: Literal["outpaint"]
    distance: Positive = 1.0
    radius: Positive = 0.6


class ImportedRequest(Closed):
    """Use the masks that came with the capture."""

    kind: Literal["imported"]


class UnionRequest(Closed):
    """What lies in any of several masks."""

    kind: Literal["union"]
    of: tuple["Part", ...] = Field(min_length=1)


class DifferenceRequest(Closed):
    """One mask without what lies in others."""

    kind: Literal["difference"]
    of: "Part"
    minus: tuple["Part", ...] = Field(min_length=1)


Part = Annotated[
    SphereRequest | BoxRequest | ObjectRequest | ScribbleRequest | ImportedRequest | UnionRequest | DifferenceRequest,
    Field(discriminator="kind"),
]


class ObjectsRequest(Closed):
    """Several things with names, each with masks of its own; `remove` says which are taken out in this run."""

    kind: Literal["objects"]
    named: dict[ObjectName, Part] = Field(min_length=1)
    remove: tuple[ObjectName, ...] | None = Field(default=None, description="None: all of them, together")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.remove is not None and not self.remove:
            raise ValueError("remove names nothing; name some of the objects, or leave it out to remove all")
        for name in self.remove or ():
            if name not in self.named:
                raise ValueError(f"remove names {name!r}, which is none of {', '.join(self.named)}")
        return self


class MaskRequest(Closed):
    """What the user asks for: `--mask REQUEST.yaml`."""

    mask: Annotated[
        SphereRequest
        | BoxRequest
        | ObjectRequest
        | ScribbleRequest
        | OutpaintRequest
        | ImportedRequest
        | UnionRequest
        | DifferenceRequest
        | ObjectsRequest,
        Field(discriminator="kind"),
    ]
    dilate: Share = Field(default=0.015, description="grown by this share of the shorter side after closing")
    shadows: bool = Field(
        default=False,
        description="also grown by the shadow that an object casts on planes that it touches, where one is found",
        exclude_if=lambda asked: not asked,
    )

    @model_validator(mode="after")
    def _check_shadows(self) -> Self:
        casting = any(isinstance(part, ObjectRequest | ImportedRequest) for part in list_parts(self.mask))
        if self.shadows and not casting:
            raise ValueError(
                f"shadows are looked for around an object or imported masks; {self.mask.kind} masks have none: "
                "leave `shadows` out"
            )
        return self


def list_parts(request: Closed) -> Iterator[Closed]:
    """A request for a mask, or the simple ones that it is put together of."""
    match request:
        case UnionRequest():
            inner = request.of
        case DifferenceRequest():
            inner = (request.of, *request.minus)
        case ObjectsRequest():
            inner = tuple(request.named.values())
        case _:
            yield request
            return
    for part in inner:
        yield from list_parts(part)


def list_views(request: Closed) -> list[str]:
    """Names of the views that a request for a mask points at."""
    names: list[str] = []
    for part in list_parts(request):
        match part:
            case ObjectRequest():
                names += [prompts.view for prompts in part.prompts]
            case ScribbleRequest():
                names.append(part.view)
            case SphereRequest(surface=SurfaceClick() as click) | BoxRequest(surface=SurfaceClick() as click):
                names.append(click.view)
            case _:
                pass
    return names
