"""The closed, frozen base of every contract model, and the primitive types that they share."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints


class StoredPath(str):
    """A path inside an artifact; the type tells a manifest which strings name its files."""

    __slots__ = ()


Digest = Annotated[str, StringConstraints(pattern=r"^sha256:[0-9a-f]{64}$")]
RelativePath = Annotated[
    str,
    # Forward slashes, no leading slash, no "..": a path can never leave its artifact.
    StringConstraints(pattern=r"^[^/\\]+(/[^/\\]+)*$"),
    AfterValidator(lambda path: StoredPath(_check_inside(path))),
]
PortName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9-]*$")]
FrameName = Annotated[
    str,
    Field(description="stem of the picture, unique in its artifact"),
    StringConstraints(pattern=r"^[^/\\]+$"),
]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1, description="a share, 0 to 1")]
Vector3 = tuple[Finite, Finite, Finite]
Row4 = tuple[Finite, Finite, Finite, Finite]
Pose = Annotated[
    tuple[Row4, Row4, Row4],
    Field(description="world_from_cam, 3x4 row-major, OpenCV axes (x right, y down, z forward)"),
]


def _check_inside(path: str) -> str:
    if ".." in path.split("/"):
        raise ValueError("a path may not leave its artifact")
    return path


class Closed(BaseModel):
    """A model that refuses fields it does not know (a typo is an error) and never changes."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False, defer_build=True)
