"""Features and verified matches, in a COLMAP database that survives a kill: what is in it is not done again."""

import shutil
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import TypeVar

import numpy as np
import pycolmap
from numpy.typing import NDArray

from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import CapturedFrame
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.snapshots import keep_snapshots, restore_snapshot

# Between two chunks a stop is honoured; each takes a second or two.
IMAGES_AT_ONCE = 8
PAIRS_AT_ONCE = 32
# Without EXIF, a lens of 1.2 times the longest side (a phone's main camera) is where the search starts.
FOCAL_GUESS = 1.2

Item = TypeVar("Item")
Pairs = list[tuple[str, str]]


def silence_pycolmap() -> None:
    """Only errors of pycolmap reach standard error."""
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)


def guess_camera(number: int, frames: Sequence[CapturedFrame], model: str) -> pycolmap.Camera:
    """A camera to start from for frames of one size: the EXIF focal length where there is one."""
    width, height = frames[0].width, frames[0].height
    focal = [f.exif.focal_px for f in frames if f.exif.focal_px]
    start = float(np.median(focal)) if focal else FOCAL_GUESS * max(width, height)
    camera = pycolmap.Camera.create_from_model_name(number, model, start, width, height)
    camera.has_prior_focal_length = bool(focal)
    return camera


def create_database(path: Path, cameras: Sequence[pycolmap.Camera], copy_of: Path | None = None) -> None:
    """A database with these cameras under their own numbers; where one was kept before, it is that."""
    if restore_snapshot(path):
        return
    if copy_of is not None:
        shutil.copyfile(copy_of, path)
    with pycolmap.Database.open(path) as database:
        for camera in cameras:
            database.write_camera(camera, use_camera_id=True)


def add_pictures(
    database: Path, folder: Path, groups: Mapping[int, Sequence[str]], config: Config, ctx: Context
) -> None:
    """Extract features of pictures (paths below `folder`), grouped by the number of their camera."""
    _number_pictures(database, groups)
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = config.feature_longest_side
    options.num_threads = ctx.threads
    options.sift.max_num_features = config.features
    reader = pycolmap.ImageReaderOptions()
    done, total = 0, sum(len(names) for names in groups.values())
    with keep_snapshots(database) as keep_when_due:
        for number, names in groups.items():
            reader.existing_camera_id = number
            for chunk in chunks(names, IMAGES_AT_ONCE):
                ctx.progress(done, total, "features")
                pycolmap.extract_features(
                    database, folder, image_names=chunk, reader_options=reader, extraction_options=options,
                    device=pycolmap.Device.cpu,
                )  # fmt: skip
                done += len(chunk)
                keep_when_due()


def _number_pictures(path: Path, groups: Mapping[int, Sequence[str]]) -> None:
    """Number the pictures in the order given: the mapper goes by numbers, and threads would give them as they end."""
    with pycolmap.Database.open(path) as database:
        rigs = {rig.ref_sensor_id.id: rig.rig_id for rig in database.read_all_rigs()}
        known = {image.name for image in database.read_all_images()}
        for number, names in groups.items():
            if number not in rigs:
                rig = pycolmap.Rig()
                rig.add_ref_sensor(database.read_camera(number).sensor_id)
                rigs[number] = database.write_rig(rig)
            for name in (n for n in names if n not in known):
                image = pycolmap.Image(name=name, camera_id=number)
                image.image_id = database.write_image(image)
                frame = pycolmap.Frame()
                frame.rig_id = rigs[number]
                frame.add_data_id(image.data_id)
                database.write_frame(frame)


def match(database: Path, pairs: Pairs, ctx: Context, *, guided: bool = False) -> None:
    """Match pictures pair by pair, and keep what one two-view geometry explains.

    guided: look for more matches along the epipolar lines of what was found; costs about as much again.
    """
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = ctx.threads
    matching.guided_matching = guided
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = ctx.seed
    listed = database.with_name(f"{database.stem}-pairs.txt")
    importing = pycolmap.ImportedPairingOptions()
    importing.match_list_path = listed
    with keep_snapshots(database) as keep_when_due:
        for i, chunk in enumerate(chunks(pairs, PAIRS_AT_ONCE)):
            ctx.progress(i * PAIRS_AT_ONCE, len(pairs), "matching")
            listed.write_text("".join(f"{a} {b}\n" for a, b in chunk))
            pycolmap.match_image_pairs(
                database, matching_options=matching, pairing_options=importing, verification_options=verification,
                device=pycolmap.Device.cpu,
            )  # fmt: skip
            keep_when_due()


def choose_pairs(names: list[str], *, ordered: bool, config: Config) -> Pairs:
    """All pairs of small or unordered sets; of ordered ones each with the next few and with some far ahead.

    Steps double beyond `overlap`, and both ends meet, so that a walk that comes back to where it was closes its loop.
    """
    way = config.matching
    if way == "auto":
        way = "sequential" if ordered and len(names) > config.exhaustive_up_to else "exhaustive"
    if way == "exhaustive" or len(names) <= config.overlap + 1:
        return list(combinations(names, 2))
    near = range(1, config.overlap + 1)
    far = [config.overlap * 2**k for k in range(1, 20)]
    steps = [step for step in [*near, *far] if step < len(names)]
    pairs: Pairs = [(names[i], names[i + step]) for step in steps for i in range(len(names) - step)]
    ends: Pairs = [(names[i], names[-1 - j]) for i in range(3) for j in range(3)]
    return list(dict.fromkeys(pairs + ends))


def chunks(items: Sequence[Item], size: int) -> list[list[Item]]:
    return [list(items[i : i + size]) for i in range(0, len(items), size)]


def number_of(database: pycolmap.Database, name: str) -> int:
    """A picture's number in the database."""
    image = database.read_image_with_name(name)
    if image is None:
        raise KeyError(f"{name} is not in the database")
    return image.image_id


def features_of(database: pycolmap.Database, name: str) -> NDArray[np.float64]:
    """Where a picture's features are, captured pixels [n, 2]."""
    return database.read_keypoints(number_of(database, name))[:, :2].astype(np.float64)
