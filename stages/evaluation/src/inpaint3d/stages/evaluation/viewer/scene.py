"""What there is to look at: the fields of a run, and the capture's cameras with their photos and masks."""

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.radiance.artifact import reduce_camera
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rendering import render_view
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.colour import to_bytes
from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.stages.evaluation.pictures import colour_depth, outline_hole

QUALITY = 90  # of JPEG
MAPS = ("colour", "depth", "opacity")


class Outrun(Exception):
    """Somebody has asked for a later picture meanwhile."""


@dataclass
class ViewerScene:
    """Fields by name (`inpainted`, `original`), cameras by the name of their photo."""

    title: str
    fields: Mapping[str, RadianceField]
    views: Mapping[str, View]
    masks: Mapping[str, Mask]
    _turn: threading.Lock = field(default_factory=threading.Lock)
    _latest: dict[str, int] = field(default_factory=dict[str, int])

    def describe(self) -> dict[str, object]:
        """What the page has to know: fields, maps, cameras (pose 3 x 4 row by row, intrinsics, size)."""
        return {
            "title": self.title,
            "fields": list(self.fields),
            "maps": list(MAPS),
            "cameras": [
                {
                    "name": name,
                    "split": view.split,
                    "pose": [float(v) for v in view.camera.world_from_cam[:3].reshape(-1)],
                    "focal": view.camera.fx / view.camera.width,
                    "aspect": view.camera.height / view.camera.width,
                    "masked": name in self.masks,
                }
                for name, view in self.views.items()
            ],
        }

    def warm_up(self) -> None:
        """Render a few pixels of every field: the first picture that a person waits for is then like the others."""
        for found in self.fields.values():
            render_view(found, reduce_camera(next(iter(self.views.values())).camera, 16))

    def render(self, name: str, kind: str, camera: Camera, session: str, order: int) -> bytes:
        """A field's colour, depth or opacity as JPEG; one at a time.

        Of two that one page (`session`) waits for the later (`order`) is made, the other is Outrun. BadInputError for
        what there is not.
        """
        if name not in self.fields or kind not in MAPS:
            raise BadInputError(f"no {kind} of {name}; there are {', '.join(MAPS)} of {', '.join(self.fields)}")
        self._latest[session] = max(self._latest.get(session, 0), order)
        with self._turn:
            if order < self._latest[session]:
                raise Outrun
            maps = render_view(self.fields[name], camera)
        return encode(draw_map(maps, kind))

    def photo(self, name: str, *, outlined: bool) -> bytes:
        """A photo as JPEG, with its mask drawn or without. KeyError where there is none."""
        image = self.views[name].image()
        return encode(outline_hole(image, self.masks[name]) if outlined and name in self.masks else image)


def draw_map(maps: Mapping[str, NDArray[np.float32]], kind: str) -> Image:
    """What `render_view` returned, as a picture."""
    if kind == "depth":
        return colour_depth(maps["depth"])
    if kind == "opacity":
        return np.repeat(maps["opacity"][..., None], 3, axis=-1)
    return maps["rgb"]


def place_camera(pose: ArrayLike, focal: float, width: int, height: int) -> Camera:
    """A pinhole camera; pose: world_from_cam, 3 x 4 row by row; focal: length over the width.

    BadInputError for what is no pose.
    """
    matrix = np.asarray(pose, np.float64).reshape(3, 4)
    rotation = matrix[:, :3]
    if not (np.isfinite(matrix).all() and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)):
        raise BadInputError("the camera's pose is no rotation and a place")
    f = focal * width
    return Camera(f, f, width / 2, height / 2, width, height, matrix)


def encode(image: Image) -> bytes:
    """A picture [h, w, 3] in [0, 1] as JPEG."""
    _, encoded = cv2.imencode(".jpg", to_bytes(image)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return encoded.tobytes()
