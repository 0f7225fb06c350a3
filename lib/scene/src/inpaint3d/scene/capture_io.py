"""Captures and posed captures on disk: views with their pictures and masks, and the sparse points between them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from inpaint3d.contracts.errors import ArtifactError
from inpaint3d.contracts.models.artifacts import (
    Capture,
    CapturedFrame,
    LensModel,
    PosedCapture,
    PosedFrame,
    PosedTruth,
    Truth,
)
from inpaint3d.contracts.models.untrusted import UntrustedError, read_safetensors_header
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.finite import find_non_finite
from inpaint3d.scene.image_io import Image, Mask, read_image, read_mask, read_opaque, write_mask, write_png


class PosedFolder(Protocol):
    """An artifact with posed frames in it; what the stage shim hands out fits."""

    @property
    def metadata(self) -> PosedCapture | PosedTruth: ...
    @property
    def root(self) -> Path: ...


class CaptureFolder(Protocol):
    """An artifact with captured frames in it."""

    @property
    def metadata(self) -> Capture | Truth: ...
    @property
    def root(self) -> Path: ...


@dataclass(frozen=True, eq=False)
class View:
    """A posed view; pictures are read when asked for, and not kept."""

    name: str
    camera: Camera
    split: Literal["train", "test"]
    relative_exposure: float | None
    image_path: Path
    mask_path: Path | None = None
    valid_path: Path | None = None

    def image(self) -> Image:
        """sRGB-encoded float32 [h, w, 3]."""
        return read_image(self.image_path)

    def mask(self) -> Mask | None:
        """The mask that came with the capture, bool [h, w], True inside the hole; None if none came."""
        return None if self.mask_path is None else read_mask(self.mask_path, self._size)

    def valid(self) -> Mask:
        """Pixels that the undistorted view really has, bool [h, w]."""
        if self.valid_path is None:
            return np.ones((self.camera.height, self.camera.width), bool)
        return read_mask(self.valid_path, self._size)

    @property
    def _size(self) -> tuple[int, int]:
        return self.camera.width, self.camera.height


@dataclass(frozen=True, eq=False)
class SparsePoints:
    """Points seen in several views, with their tracks in compressed rows.

    xyz float32 [p, 3] (scene units), rgb uint8 [p, 3], error float32 [p] (px), track_offsets int64 [p + 1];
    track_frame int32 [t] (index into the frames) and track_xy float32 [t, 2] (pixels of the undistorted view): those
    of point i are rows track_offsets[i] to track_offsets[i + 1].
    """

    xyz: NDArray[np.float32]
    rgb: NDArray[np.uint8]
    error: NDArray[np.float32]
    track_offsets: NDArray[np.int64]
    track_frame: NDArray[np.int32]
    track_xy: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def track_point(self) -> NDArray[np.int64]:
        """Which point each row of the tracks belongs to, [t]."""
        return np.repeat(np.arange(len(self)), np.diff(self.track_offsets))

    def select(self, keep: ArrayLike) -> "SparsePoints":
        """Only the points where `keep` bool [p] is True."""
        keep = np.asarray(keep, bool)
        rows = keep[self.track_point]
        lengths = np.diff(self.track_offsets)[keep]
        return SparsePoints(
            xyz=self.xyz[keep],
            rgb=self.rgb[keep],
            error=self.error[keep],
            track_offsets=np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
            track_frame=self.track_frame[rows],
            track_xy=self.track_xy[rows],
        )


_POINTS: dict[str, tuple[type, tuple[int, ...]]] = {
    "xyz": (np.float32, (3,)),
    "rgb": (np.uint8, (3,)),
    "error": (np.float32, ()),
    "track_offsets": (np.int64, ()),
    "track_frame": (np.int32, ()),
    "track_xy": (np.float32, (2,)),
}


def load_posed(artifact: PosedFolder) -> list[View]:
    """The views of a posed capture or posed truth, in the artifact's order."""
    root = artifact.root
    return [
        View(
            name=frame.name,
            camera=Camera.from_model(frame),
            split=frame.split,
            relative_exposure=frame.relative_exposure,
            image_path=root / frame.path,
            mask_path=root / frame.mask if frame.mask else None,
            valid_path=root / frame.valid if frame.valid else None,
        )
        for frame in artifact.metadata.frames
    ]


def load_points(path: Path) -> SparsePoints:
    """Read `points.safetensors`; ArtifactError where an array is missing, has another shape, is not finite, or where
    tracks are not those of the points.
    """
    try:
        read_safetensors_header(path)
        arrays = load_file(path)
    except (UntrustedError, SafetensorError) as error:
        raise ArtifactError(f"{path}: {error}; run pose-estimation") from error
    for name, (dtype, tail) in _POINTS.items():
        found = arrays.get(name)
        if found is None or found.dtype != dtype or found.shape[1:] != tail:
            what = "missing" if found is None else f"{found.dtype} {found.shape}"
            raise ArtifactError(f"{path}: {name} is {what}, not {np.dtype(dtype)} [n, *{tail}]; run pose-estimation")
    if strange := find_non_finite(arrays):
        raise ArtifactError(f"{path}: numbers that are not finite: {', '.join(map(str, strange))}; run pose-estimation")
    _check_tracks(arrays, path)
    return SparsePoints(**{name: arrays[name] for name in _POINTS})


def _check_tracks(arrays: dict[str, NDArray[Any]], path: Path) -> None:
    offsets, frames, count = arrays["track_offsets"], arrays["track_frame"], len(arrays["xyz"])
    ends = offsets.tolist()
    sound = (
        ends[:1] == [0]
        and ends[-1:] == [len(frames)] == [len(arrays["track_xy"])]
        and bool((np.diff(offsets) >= 0).all())
        and {len(arrays["rgb"]), len(arrays["error"]), len(offsets) - 1} == {count}
        and frames.min(initial=0) >= 0
    )
    if not sound:
        raise ArtifactError(
            f"{path}: {len(frames)} sightings of views from {frames.min(initial=0)} on do not fall to {count} points "
            f"by track_offsets {ends[:1]} to {ends[-1:]}; run pose-estimation"
        )


def write_points(path: Path, points: SparsePoints) -> None:
    """Write `points.safetensors`."""
    arrays = {name: np.ascontiguousarray(getattr(points, name), dtype) for name, (dtype, _) in _POINTS.items()}
    save_file(arrays, path)


def write_view(
    folder: Path,
    name: str,
    image: ArrayLike,
    camera: Camera,
    *,
    split: Literal["train", "test"] = "train",
    relative_exposure: float | None = None,
    mask: ArrayLike | None = None,
    valid: ArrayLike | None = None,
    lens: LensModel | None = None,
) -> PosedFrame:
    """Write a posed view's picture (and masks, where given) under an artifact's folder; returns its record."""
    write_png(folder / "frames" / f"{name}.png", image)
    if mask is not None:
        write_mask(folder / "masks" / f"{name}.png", mask)
    if valid is not None:
        write_mask(folder / "valid" / f"{name}.png", valid)
    return PosedFrame(
        name=name,
        path=f"frames/{name}.png",
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        world_from_cam=camera.pose,
        lens=lens,
        split=split,
        relative_exposure=relative_exposure,
        mask=f"masks/{name}.png" if mask is not None else None,
        valid=f"valid/{name}.png" if valid is not None else None,
    )


def read_captured_image(artifact: CaptureFolder, frame: CapturedFrame) -> Image:
    """A captured frame's picture, sRGB-encoded float32 [h, w, 3]."""
    return read_image(artifact.root / frame.path)


def read_captured_mask(artifact: CaptureFolder, frame: CapturedFrame) -> Mask | None:
    """The mask that came with a captured frame, bool [h, w]; None if none came."""
    if frame.mask is None:
        return None
    return read_mask(artifact.root / frame.mask, (frame.width, frame.height))


def read_captured_valid(artifact: CaptureFolder, frame: CapturedFrame) -> Mask | None:
    """Where a captured frame shows the scene, bool [h, w]: its alpha channel; None where all of it does."""
    return read_opaque(artifact.root / frame.path)
