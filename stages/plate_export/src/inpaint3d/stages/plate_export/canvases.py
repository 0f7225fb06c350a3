"""Views to paint in: undistorted pictures of the photo's own size, where they may be painted, and both as a cut-out."""

from pathlib import Path

import cv2
import numpy as np

from inpaint3d.contracts.models.artifacts import Canvas
from inpaint3d.scene.colour import to_bytes
from inpaint3d.scene.image_io import read_image, write_mask, write_png
from inpaint3d.stages.plate_export.lens import Box, PhotoCamera
from inpaint3d.stages.plate_export.views import PlateView

ROWS = 512  # at once, for memory's sake


def write_canvas(folder: Path, view: PlateView, plate: Path) -> Canvas:
    """Write the view's canvas below `folder`, from its plate's file."""
    picture = read_image(plate)
    height, width = picture.shape[:2]
    made, hole = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), bool)
    camera = view.camera
    for top in range(0, height, ROWS):
        box = Box(0, top, width, min(top + ROWS, height))
        rays = _cast_canvas_rays(camera, box)
        xy = (camera.project(rays) - 0.5).astype(np.float32)
        rows = slice(box.y0, box.y1)
        made[rows] = to_bytes(
            cv2.remap(picture, xy[..., 0], xy[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        )
        hole[rows] = view.covers(rays)
    name = view.name
    write_png(folder / f"canvases/{name}.png", made)
    write_mask(folder / f"canvases/{name}.mask.png", hole)
    alpha = np.where(hole, np.uint8(0), np.uint8(255))
    write_png(folder / f"canvases/{name}.cutout.png", np.concatenate([made, alpha[..., None]], -1))
    return Canvas(
        name=name,
        picture=f"canvases/{name}.png",
        mask=f"canvases/{name}.mask.png",
        cutout=f"canvases/{name}.cutout.png",
    )


def _cast_canvas_rays(camera: PhotoCamera, box: Box) -> np.ndarray:
    canvas = camera.canvas
    x, y = np.meshgrid(np.arange(box.x0, box.x1) + 0.5, np.arange(box.y0, box.y1) + 0.5)
    return np.stack([(x - canvas.cx) / canvas.fx, (y - canvas.cy) / canvas.fy], -1)
