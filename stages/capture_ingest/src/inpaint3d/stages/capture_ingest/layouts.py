"""The layouts that a source can have, each told by all of its marks, and what is read of each."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts.capture import UNREADABLE_SUFFIXES, VIDEO_SUFFIXES
from inpaint3d.stages.capture_ingest import (
    blender,
    colmap,
    llff,
    nerfstudio,
    photos,
    realestate10k,
    spin_nerf,
    video,
)
from inpaint3d.stages.capture_ingest.config import Config
from inpaint3d.stages.capture_ingest.found import Found, files_below, pictures_below


@dataclass(frozen=True)
class Layout:
    """One row of docs/how-to/captures.md."""

    marks: str
    cameras: str
    masks: str
    truth: str


BESIDE = "`masks/`, white is the hole"
# In the order in which they are tried: what has more marks comes first.
LAYOUTS = {
    "spin-nerf": Layout(
        "`images_4/label/` and `poses_bounds.npy`", "as llff", "`images_4/label/`, by name, else by order",
        "the first 40 files (`spin_nerf_truth`), masks in `test_label/`",
    ),
    "nerfstudio": Layout(
        "`transforms.json`", "for all frames or for each, OpenGL axes",
        f"`mask_path` (black is the hole), else {BESIDE}", "",
    ),
    "blender": Layout(
        "`transforms_train.json`", "as nerfstudio", "as nerfstudio",
        "`transforms_test.json`, unless `blender_truth=false`",
    ),
    "colmap": Layout("`sparse/0/`, or the largest model of `sparse/`", "text or binary model", BESIDE, ""),
    "llff": Layout(
        "`poses_bounds.npy`", "rows in the order of names as text, or as numbers, as the pictures support", BESIDE, ""
    ),
    "realestate10k": Layout(
        "a text file that begins with a video's address", "from the file; 80 frames at 360 rows (parameters)", "", ""
    ),
    "video": Layout("one video and at most one picture", "to be estimated", "", ""),
    "photos": Layout("anything else with pictures", "to be estimated", BESIDE, "`truth/` beside `images/`"),
}  # fmt: skip


def detect(raw: Path) -> list[str]:
    """The layouts whose marks the files have, the one to be taken first; photos where nothing else fits.

    BadInputError where there is half of a COLMAP model.
    """
    poses = (raw / llff.FILE).is_file()
    colmap.check_halves(raw)
    fits = {
        "spin-nerf": poses and (raw / spin_nerf.FOLDER / spin_nerf.LABELS).is_dir(),
        "nerfstudio": (raw / nerfstudio.FILE).is_file(),
        "blender": (raw / blender.FILE).is_file(),
        # A model names its pictures; LLFF's rows, often beside one, don't.
        "colmap": bool(colmap.model_folders(raw)),
        "llff": poses,
    }
    if marked := [layout for layout, fit in fits.items() if fit]:
        return marked
    if realestate10k.is_layout(raw):
        return ["realestate10k"]
    return ["video" if _list_videos(raw) and len(photos.list_photos(raw)) < 2 else "photos"]


def find(raw: Path, config: Config, work: Path) -> Found:
    """The frames of a source by its layout, with what is to be said of it."""
    layout, *others = detect(raw) if config.layout == "auto" else [config.layout]
    found = _find(layout, raw, config, work)
    found.notes.insert(0, _describe(found, marks_of(layout) if config.layout == "auto" else "capture-ingest.layout"))
    if others:
        found.notes.append(
            f"it has the marks of {', '.join(others)}, too; capture-ingest.layout={others[0]} takes it so"
        )
    if layout != "video" and (clips := _list_videos_below(raw)):
        found.notes.append(f"{len(clips)} videos lie beside the pictures and are left out ({clips[0].name})")
    if layout != "realestate10k":  # it says how many frames of which clip
        found.notes.extend(_list_left_out(raw, found))
    return found


def _list_left_out(raw: Path, found: Found) -> list[str]:
    """A note on pictures that are neither frames nor masks, folder by folder."""
    views = [*found.frames, *found.truth]
    used = {f.image for f in views} | {f.mask for f in views}
    left = Counter(p.parent.relative_to(raw).as_posix() for p in pictures_below(raw) if p not in used)
    if not left:
        return []
    folders = [f"{count} of {'the top' if place == '.' else f'{place}/'}" for place, count in left.items()]
    shown = ", ".join(folders[:5]) + (", ..." if len(folders) > 5 else "")
    return [f"{left.total()} pictures are neither frames nor masks and left out: {shown}"]


def _describe(found: Found, why: str) -> str:
    """The one line that says what a source was taken for."""
    cameras = sum(frame.camera is not None for frame in found.frames)
    masks = sum(frame.mask is not None for frame in found.frames)
    return (
        f"taken for {found.layout} (by {why}): {len(found.frames)} pictures, {cameras} cameras, {masks} masks, "
        f"{len(found.truth)} truth views"
    )


def marks_of(layout: str) -> str:
    return LAYOUTS[layout].marks.replace("`", "")


def _find(layout: str, raw: Path, config: Config, work: Path) -> Found:
    if layout == "video":
        return video.find(_find_only_video(raw), config.video_frames, work)
    if layout == "spin-nerf":
        return spin_nerf.find(raw, config.spin_nerf_truth)
    if layout == "blender":
        return blender.find(raw, config.blender_truth)
    if layout == "realestate10k":
        rows, count = config.realestate10k_rows, config.realestate10k_frames
        return realestate10k.find(raw, config.realestate10k_clip, count, rows, work)
    return {"photos": photos, "colmap": colmap, "nerfstudio": nerfstudio, "llff": llff}[layout].find(raw)


def _list_files(raw: Path) -> list[Path]:
    return sorted(p for p in raw.iterdir() if p.is_file()) if raw.is_dir() else []


def _list_videos(raw: Path) -> list[Path]:
    return [p for p in _list_files(raw) if p.suffix.lower() in VIDEO_SUFFIXES and not p.name.startswith(".")]


def _list_videos_below(raw: Path) -> list[Path]:
    return [p for p in files_below(raw) if p.suffix.lower() in VIDEO_SUFFIXES]


def _find_only_video(raw: Path) -> Path:
    videos = _list_videos(raw)
    if len(videos) != 1:
        raise BadInputError(f"{len(videos)} videos in {describe_folder(raw)}; give exactly one")
    return videos[0]


def describe_folder(raw: Path) -> str:
    """What lies in it, and the way out for pictures of kinds that are not read."""
    names = [p.name for p in sorted(raw.iterdir())] if raw.is_dir() else []
    if not names:
        return "an empty folder"
    unread = next((p for p in sorted(raw.rglob("*")) if p.suffix.lower() in UNREADABLE_SUFFIXES), None)
    way_out = f" ({unread.suffix} is not read: {UNREADABLE_SUFFIXES[unread.suffix.lower()]})" if unread else ""
    if clips := [p for p in _list_videos_below(raw) if p.parent != raw]:
        way_out += f" ({clips[0].relative_to(raw)} is a video below it: give the file itself)"
    return f"a folder holding {', '.join(names[:5])}{', ...' if len(names) > 5 else ''}{way_out}"
