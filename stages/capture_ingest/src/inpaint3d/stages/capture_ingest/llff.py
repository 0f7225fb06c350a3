"""LLFF: poses_bounds.npy, a row of 17 numbers for each picture: 3x5 pose with [height, width, focal], near, far."""

from pathlib import Path

import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.scene.image_io import read_header
from inpaint3d.stages.capture_ingest.axes import from_llff
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame, masks_for, pictures_in

FILE = "poses_bounds.npy"


def read_cameras(root: Path, pictures: list[Path]) -> list[KnownCamera]:
    """One camera for each picture, in sorted order, its focal length scaled to the picture's own size."""
    try:
        rows = np.load(root / FILE, allow_pickle=False)
    except ValueError as error:
        raise BadInputError(f"{FILE} cannot be read ({error}); export it again") from error
    if rows.ndim != 2 or rows.shape[1] != 17:
        raise BadInputError(f"{FILE} is {rows.shape}, not [pictures, 17]; export it again")
    if len(rows) != len(pictures):
        raise BadInputError(f"{FILE} has {len(rows)} cameras for {len(pictures)} pictures; they must be as many")
    cameras: list[KnownCamera] = []
    for row, path in zip(rows, pictures, strict=True):
        pose = row[:15].reshape(3, 5)
        _, pose_width, focal = pose[:, 4]
        width, height = read_header(path).upright_size
        scaled = float(focal) * width / float(pose_width)
        params = (scaled, scaled, width / 2, height / 2)
        cameras.append(KnownCamera(model="PINHOLE", params=params, world_from_cam=from_llff(pose[:, :4])))
    return cameras


def find(root: Path) -> Found:
    """Frames of `images/` with the cameras of the file, and masks where there are any."""
    folder = root / "images" if (root / "images").is_dir() else root
    pictures = pictures_in(folder)
    cameras = read_cameras(root, pictures)
    masks = masks_for(pictures, root / "masks") if (root / "masks").is_dir() else {}
    pairs = zip(pictures, cameras, strict=True)
    return Found("llff", [FoundFrame(p.stem, p, masks.get(p.stem), c) for p, c in pairs])
