"""SIFT features and matches in a COLMAP database, kept in the work folder so that a rerun goes on."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import pycolmap

from inpaint3d.contracts.artifacts import CapturedFrame
from inpaint3d.contracts.context import Context
from inpaint3d.stages.pose_estimation.config import Config

# One distortion parameter is what every phone needs and every capture can carry; richer models are tried afterwards.
FIRST_MODEL = "SIMPLE_RADIAL"
QUIET = 2


def link(frames: Sequence[CapturedFrame], root: Path, folder: Path) -> list[str]:
    """Give COLMAP the pictures under `folder`; returns their names relative to its parent."""
    folder.mkdir(parents=True, exist_ok=True)
    names: list[str] = []
    for frame in frames:
        target = folder / Path(frame.path).name
        if not target.is_symlink():
            target.symlink_to((root / frame.path).resolve())
        names.append(f"{folder.name}/{target.name}")
    return names


def extract(
    database: Path, pictures: Path, frames: Sequence[CapturedFrame], names: Sequence[str], config: Config, ctx: Context
) -> None:
    """Features of every picture; pictures of one size share a camera."""
    pycolmap.logging.minloglevel = QUIET
    options = pycolmap.FeatureExtractionOptions(
        use_gpu=False, num_threads=ctx.threads, max_image_size=config.feature_size
    )
    options.sift.max_num_features = config.features
    by_size: dict[tuple[int, int], list[str]] = defaultdict(list)
    for frame, name in zip(frames, names, strict=True):
        by_size[(frame.width, frame.height)].append(name)
    for group in by_size.values():
        pycolmap.extract_features(
            database,
            pictures,
            group,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=pycolmap.ImageReaderOptions(camera_model=FIRST_MODEL),
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )


def match(database: Path, count: int, *, ordered: bool, config: Config, ctx: Context) -> str:
    """Match by the capture's order and size, and verify; returns what was done, in words."""
    options = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=ctx.threads)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = ctx.seed
    if ordered and count > config.exhaustive_up_to:
        pairing = pycolmap.SequentialPairingOptions(overlap=config.overlap, loop_detection=False)
        pycolmap.match_sequential(database, options, pairing, verification, device=pycolmap.Device.cpu)
        return f"sequential, overlap {config.overlap}"
    pycolmap.match_exhaustive(database, options, verification_options=verification, device=pycolmap.Device.cpu)
    return "exhaustive"
