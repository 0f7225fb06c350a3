"""What a mask request means on this capture: views found by name, pixels moved to the posed frames."""

import difflib
import json

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts.masks import ObjectPrompts, ScribbleRequest, SurfaceClick
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import View
from inpaint3d.stages.mask_authoring.segment import Prompts

Floats = NDArray[np.float64]

ASPECT_TOLERANCE = 0.05  # undistortion crops a little


def find_view(views: list[View], name: str) -> int:
    """Index of the view of that name; ConfigurationError that suggests near names."""
    names = [v.name for v in views]
    if name in names:
        return names.index(name)
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.4) or names[:3]
    raise ConfigurationError(
        f"mask request: there is no view {name!r} among the {len(names)} posed views; did you mean "
        f"{' or '.join(map(repr, near))}? (a name is the picture's file name without its suffix)"
    )


def object_prompts(request: ObjectPrompts, camera: Camera) -> Prompts:
    """Points and box in pixels of the posed frame; ConfigurationError where they lie outside."""
    size = request.frame_size
    points = _in_frame(request.points, size, camera, "point")
    background = _in_frame(request.background, size, camera, "background point")
    if request.box is None:
        return Prompts(points, background)
    x0, y0, x1, y1 = request.box
    low, high = _in_frame(((x0, y0), (x1, y1)), size, camera, "box corner", inclusive=True)
    return Prompts(points, background, (low[0], low[1], high[0], high[1]))


def surface_pixel(click: SurfaceClick, camera: Camera) -> Floats:
    """Where a surface was clicked at [2], in pixels of the posed frame."""
    return _in_frame((click.at,), click.frame_size, camera, "at")[0]


def scribble_path(request: ScribbleRequest, camera: Camera) -> Floats:
    """The drawn path [n, 2] in pixels of the posed frame."""
    return _in_frame(request.path, request.frame_size, camera, "path point")


def example_request(view: View) -> str:
    """A mask request that fits this capture, to start from."""
    width, height = view.camera.width, view.camera.height
    lines = [
        "mask:",
        "  kind: object",
        f"  view: {json.dumps(view.name)}",
        f"  frame_size: [{width}, {height}]   # of the picture on which you read the pixels off",
        f"  points: [[{width // 2}, {height // 2}], [{width // 2}, {round(height * 0.6)}]]   # x, y on the object",
    ]
    return "\n".join(lines)


def _in_frame(
    points: tuple[tuple[float, float], ...],
    frame_size: tuple[int, int] | None,
    camera: Camera,
    what: str,
    *,
    inclusive: bool = False,
) -> Floats:
    """Points read on a picture of `frame_size`, in pixels of the posed frame [n, 2]."""
    width, height = frame_size or (camera.width, camera.height)
    ratio = (width / height) / (camera.width / camera.height)
    if abs(np.log(ratio)) > ASPECT_TOLERANCE:
        raise ConfigurationError(
            f"mask request: frame_size [{width}, {height}] has not the shape of the view, which is "
            f"{camera.width}x{camera.height}; give width and height of the picture the pixels were read on"
        )
    for x, y in points:
        if not (0 <= x < width or (inclusive and x == width)) or not (0 <= y < height or (inclusive and y == height)):
            hint = "" if frame_size else " (set frame_size if they were read on a picture of another size)"
            raise ConfigurationError(
                f"mask request: {what} [{x:g}, {y:g}] is outside the picture of {width}x{height} pixels{hint}"
            )
    xy = np.array(points, np.float64).reshape(-1, 2)
    return xy * (camera.width / width, camera.height / height)
