"""Photos, a video or a data set become a capture: find the frames, look at every one, carry them over."""

import shutil
from pathlib import Path

import cv2
import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, Exif, Source, Truth
from inpaint3d.scene.image_io import Header, read_header, read_image, read_mask, write_mask, write_png
from inpaint3d.stages.capture_ingest import colmap, llff, nerfstudio, photos, realestate10k, spin_nerf, video
from inpaint3d.stages.capture_ingest.config import Config
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame

KEPT_AS_THEY_ARE = ("jpeg", "png")
FILM_WIDTH_MM = 36.0
ASPECT_TOLERANCE = 0.01


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Write `capture`, and `truth` where the source has views to score against."""
    source = inputs.one("source", Source)
    raw = source.root / "raw"
    try:
        _ingest(raw, config, outputs, ctx)
    except BadInputError as error:
        # The file to repair is the user's; the store's copy of it is of no use to anybody.
        raise BadInputError(f"{source.metadata.name}: {str(error).replace(f'{raw}/', '')}") from error


def _ingest(raw: Path, config: Config, outputs: Outputs, ctx: Context) -> None:
    found = find(raw, config, ctx.work)
    for note in found.notes:
        ctx.log(note)
    if len(found.frames) < 2:
        raise BadInputError(
            f"{len(found.frames)} pictures in {_describe_folder(raw)} ({found.layout} layout); "
            "a scene needs at least 2, better 20 or more that overlap by half"
        )
    total = len(found.frames) + len(found.truth)
    folder = outputs.folder("capture")
    frames = tuple(_carry(f, folder, i, total, ctx) for i, f in enumerate(found.frames))
    outputs.write("capture", Capture(layout=found.layout, ordered=found.ordered, frames=frames))  # pyright: ignore[reportArgumentType]
    if found.truth:
        folder = outputs.folder("truth")
        kept = tuple(_carry(f, folder, len(frames) + i, total, ctx) for i, f in enumerate(found.truth))
        outputs.write("truth", Truth(frames=kept))


def find(raw: Path, config: Config, work: Path) -> Found:
    """The frames of a source by its layout."""
    layout = detect(raw) if config.layout == "auto" else config.layout
    if layout == "video":
        return video.find(_only_video(raw), config.video_frames, work)
    if layout == "spin-nerf":
        return spin_nerf.find(raw, config.spin_nerf_truth)
    if layout == "realestate10k":
        rows, count = config.realestate10k_rows, config.realestate10k_frames
        return realestate10k.find(raw, config.realestate10k_clip, count, rows, work)
    return {"photos": photos, "colmap": colmap, "nerfstudio": nerfstudio, "llff": llff}[layout].find(raw)


def detect(raw: Path) -> str:
    """Which layout the files are those of; photos where nothing else fits."""
    if (raw / spin_nerf.FOLDER).is_dir() and (raw / llff.FILE).is_file():
        return "spin-nerf"
    if (raw / nerfstudio.FILE).is_file():
        return "nerfstudio"
    if (raw / llff.FILE).is_file():
        return "llff"
    if colmap.model_folder(raw) is not None:
        return "colmap"
    if realestate10k.is_layout(raw):
        return "realestate10k"
    if any(p.suffix.lower() in video.SUFFIXES for p in _files(raw)):
        return "video"
    return "photos"


def _files(raw: Path) -> list[Path]:
    return sorted(p for p in raw.iterdir() if p.is_file()) if raw.is_dir() else []


def _only_video(raw: Path) -> Path:
    videos = [p for p in _files(raw) if p.suffix.lower() in video.SUFFIXES]
    if len(videos) != 1:
        raise BadInputError(f"{len(videos)} videos in {_describe_folder(raw)}; give exactly one")
    return videos[0]


def _describe_folder(raw: Path) -> str:
    names = [p.name for p in sorted(raw.iterdir())] if raw.is_dir() else []
    return f"a folder holding {', '.join(names[:5])}{', ...' if len(names) > 5 else ''}" if names else "an empty folder"


def _carry(frame: FoundFrame, folder: Path, index: int, total: int, ctx: Context) -> CapturedFrame:
    """Decode a picture (a damaged one is found here), carry it over, resample its mask to its size."""
    header = read_header(frame.image)
    image = read_image(frame.image)
    height, width = image.shape[:2]
    as_it_is = header.format in KEPT_AS_THEY_ARE and header.bits == 8 and header.orientation == 1
    suffix = (".jpg" if header.format == "jpeg" else ".png") if as_it_is else ".png"
    target = folder / "frames" / f"{frame.name}{suffix}"
    target.parent.mkdir(parents=True, exist_ok=True)
    if as_it_is:
        shutil.copyfile(frame.image, target)
    else:
        write_png(target, image)
    mask = None
    if frame.mask is not None:
        mask = f"masks/{frame.name}.png"
        write_mask(folder / mask, fit_mask(frame.mask, width, height))
    ctx.progress(index + 1, total, frame.name)
    return CapturedFrame(
        name=frame.name,
        path=f"frames/{target.name}",
        width=width,
        height=height,
        exif=read_exif(header, width, height),
        camera=frame.camera,
        mask=mask,
    )


def fit_mask(path: Path, width: int, height: int) -> np.ndarray:
    """The mask at its picture's size. BadInputError where its aspect ratio is another: it is of another picture."""
    mask = read_mask(path)
    h, w = mask.shape
    if abs(w * height / (h * width) - 1) > ASPECT_TOLERANCE:
        raise BadInputError(
            f"mask {path.name} is {w}x{h} but its picture is {width}x{height}, another aspect ratio; "
            "make the mask on that picture"
        )
    if (w, h) == (width, height):
        return mask
    return cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST).astype(bool)


def read_exif(header: Header, width: int, height: int) -> Exif:
    """What the camera recorded, as far as it makes sense."""
    values = header.exif

    def number(*names: str) -> float | None:
        for name in names:
            value = values.get(name)
            if isinstance(value, (int, float)) and value > 0:
                return float(value)
        return None

    film = number("Exif:FocalLengthIn35mmFilm")
    make, model = (str(values.get(k, "")).strip() for k in ("Make", "Model"))
    return Exif(
        focal_px=film / FILM_WIDTH_MM * max(width, height) if film else None,
        exposure_s=number("ExposureTime", "Exif:ExposureTime"),
        iso=number("Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings"),
        f_number=number("FNumber", "Exif:FNumber"),
        camera=f"{make} {model}".strip() or None,
    )
