"""A clip of RealEstate10k as a capture: consecutive frames with their cameras, at the paper's size (S1)."""

from pathlib import Path

import cv2

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.scene.cameras import as_pose
from inpaint3d.scene.image_io import read_image, write_png
from inpaint3d.scene.realestate10k import Clip, ClipFrame, camera_files, read_clips
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame


def is_layout(root: Path) -> bool:
    return next(camera_files(root), None) is not None


def find(root: Path, name: str | None, count: int, rows: int, folder: Path) -> Found:
    """The first `count` frames of a clip, brought to `rows` rows below `folder`.

    Raises BadInputError where the clip is not there, or there are several and none is named.
    """
    clip = _choose_clip(read_clips(root), name)
    frames = [_make_frame(frame, rows, folder) for frame in clip.frames[:count]]
    left = len(clip.frames) - len(frames)
    notes = [f"clip {clip.name}: its first {len(frames)} frames, {left} more are left out"] if left else []
    return Found("realestate10k", frames, notes=notes)


def _choose_clip(clips: list[Clip], name: str | None) -> Clip:
    names = [clip.name for clip in clips]
    chosen = clips if name is None else [clip for clip in clips if clip.name == name]
    if len(chosen) != 1:
        what = f"no clip {name}" if name else f"{len(clips)} clips with frames"
        shown = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
        raise BadInputError(
            f"{what} in this RealEstate10k folder (there are {shown or 'none'}); set capture-ingest.realestate10k_clip "
            "to one of them, and see that its frames lie in a folder of its name"
        )
    return chosen[0]


def _make_frame(frame: ClipFrame, rows: int, folder: Path) -> FoundFrame:
    image = read_image(frame.image)
    height, width = image.shape[:2]
    columns = round(width * rows / height)
    target = folder / f"{frame.image.stem}.png"
    write_png(target, cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA))
    fx, fy, cx, cy = frame.intrinsics
    params = (fx * columns, fy * rows, cx * columns, cy * rows)
    camera = KnownCamera(model="PINHOLE", params=params, world_from_cam=as_pose(frame.world_from_cam))
    return FoundFrame(target.stem, target, camera=camera)
