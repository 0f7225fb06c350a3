"""What the page shows: the views of a capture as far as they are known, as pictures that a browser reads."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from inpaint3d.contracts.models.artifacts import Capture, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import View, load_posed
from inpaint3d.scene.colour import to_bytes
from inpaint3d.scene.image_io import Image
from inpaint3d.stages.mask_authoring.sam import SegmentAnything
from inpaint3d.stages.mask_authoring.scene import Scene, load_scene
from inpaint3d.stages.mask_authoring.views import DepthView

PICTURE_SIDE = 1600
"""Pixels; the longest side of a picture on the page. Requests say so in `frame_size`."""
THUMBNAIL_SIDE = 160
CARRYING_SIDE = 480  # pixels; masks on the page are carried on pictures of at most this size
NO_CAMERAS = "Cameras are not known yet: masks are shown on the picture that you point at, and a sphere has no place."
NO_FIELD = "There is no field yet, and so no depth: masks are shown on the picture that you point at."


@dataclass(frozen=True, eq=False)
class Subject:
    """The views to point at. Without a field they have no depth: masks are found on single pictures."""

    scene: Scene
    missing: str | None
    """What of the capture is not there yet, in words for a person; None where masks can be carried."""

    def names(self) -> list[str]:
        return [view.name for view in self.scene.views]

    def picture_size(self, index: int) -> tuple[int, int]:
        """Width and height of a view's picture on the page."""
        camera = self.scene.views[index].camera
        return fit_size(camera.width, camera.height, PICTURE_SIDE)

    def picture(self, index: int, longest: int) -> bytes:
        """A view's picture as JPEG, its longest side at most `longest` pixels."""
        view = self.scene.views[index]
        size = fit_size(view.camera.width, view.camera.height, longest)
        pixels = cv2.resize(view.image(), size, interpolation=cv2.INTER_AREA)
        _, encoded = cv2.imencode(".jpg", to_bytes(pixels)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
        return encoded.tobytes()


def fit_size(width: int, height: int, longest: int) -> tuple[int, int]:
    """The size of a picture made so small that its longest side is at most `longest`; never larger than it was."""
    scale = min(1.0, longest / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def open_subject(
    capture: Artifact[Capture],
    posed: Artifact[PosedCapture] | None,
    field: Artifact[RadianceFieldArtifact] | None,
    segmenter: SegmentAnything | None = None,
) -> Subject:
    """The views with cameras and depth where these are there; else those with cameras, else the pictures alone.

    segmenter: what cuts an object out where it is pointed at; None: GrabCut.
    """
    if posed is not None and field is not None:
        scene, missing = load_scene(posed, field), None
    elif posed is not None:
        scene, missing = _without_depth(load_posed(posed), ordered=posed.metadata.ordered), NO_FIELD
    else:
        scene, missing = _without_depth(_pictures_alone(capture), ordered=capture.metadata.ordered), NO_CAMERAS
    small = [_keep_small(view) for view in scene.depth_views]
    return Subject(replace(scene, depth_views=small, segmenter=segmenter), missing)


def _without_depth(views: list[View], *, ordered: bool) -> Scene:
    nowhere = np.full((1, 1), np.inf)
    return Scene(views, [DepthView(v.name, v.camera, nowhere, v.image) for v in views], [], ordered)


def _pictures_alone(capture: Artifact[Capture]) -> list[View]:
    """Captured frames as views of cameras that mean nothing: only their sizes are asked for."""
    views: list[View] = []
    for frame in capture.metadata.frames:
        side = float(max(frame.width, frame.height))
        camera = Camera(side, side, frame.width / 2, frame.height / 2, frame.width, frame.height, np.eye(4))
        views.append(View(frame.name, camera, "train", None, capture.root / frame.path))
    return views


def _keep_small(view: DepthView) -> DepthView:
    """The view at the size that masks are carried at, its picture decoded once."""
    width, height = fit_size(view.camera.width, view.camera.height, CARRYING_SIDE)
    small = view.resized(width, height) if width < view.camera.width else view
    return replace(small, image=_keep_decoded(small.image))


def _keep_decoded(image: Callable[[], Image]) -> Callable[[], Image]:
    kept: list[Image] = []

    def read() -> Image:
        if not kept:
            kept.append(image())
        return kept[0]

    return read
