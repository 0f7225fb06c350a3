"""From features to a sparse model: incremental mapping, or triangulation under cameras that are known."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import ArrayLike, NDArray

from inpaint3d.contracts.errors import InterruptedRun
from inpaint3d.contracts.kit.context import Context
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.snapshots import restore_snapshot, save_snapshot


@dataclass(frozen=True)
class Found:
    """The largest model (None: there is none) and how many views each model has, largest first."""

    model: pycolmap.Reconstruction | None
    sizes: list[int]


def estimate(database: Path, folder: Path, work: Path, config: Config, ctx: Context) -> Found:
    """Incremental mapping with a seed; models already found before a kill are read again."""
    done = work / "models"
    if not restore_snapshot(done):
        done.mkdir()
        _map(database, folder, done, config, ctx)
        save_snapshot(done)
    models = [pycolmap.Reconstruction(p) for p in sorted(done.glob("*")) if (p / "images.bin").is_file()]
    models.sort(key=lambda m: (-m.num_reg_images(), -m.num_points3D()))
    return Found(models[0] if models else None, [m.num_reg_images() for m in models])


def _map(database: Path, folder: Path, output: Path, config: Config, ctx: Context) -> None:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = ctx.seed
    # More threads change the order of sums, and so the last digits.
    options.num_threads = 1
    options.extract_colors = False
    options.min_model_size = config.min_registered
    token = pycolmap.CancellationToken()
    registered = 2
    stopped: list[InterruptedRun] = []

    def registered_one() -> None:
        nonlocal registered
        registered += 1
        try:
            ctx.progress(registered, registered + 1, "mapping")
        except InterruptedRun as error:  # must not unwind through the mapper
            stopped.append(error)
            token.cancel()

    pycolmap.incremental_mapping(
        database, folder, output, options, next_image_callback=registered_one, cancellation_token=token
    )
    if stopped:
        raise stopped[0]


def triangulate(
    database: Path,
    folder: Path,
    work: Path,
    lenses: Mapping[int, pycolmap.Camera],
    known: Mapping[str, tuple[int, NDArray[np.float64]]],
    ctx: Context,
) -> pycolmap.Reconstruction:
    """Points under known cameras: poses and lenses stay as they are. `known`: name -> (lens, pose)."""
    given = pycolmap.Reconstruction()
    for lens in lenses.values():
        given.add_camera_with_trivial_rig(lens)
    with pycolmap.Database.open(database) as db:
        numbers = {image.name: image.image_id for image in db.read_all_images()}
    for name, (lens, pose) in known.items():
        image = pycolmap.Image(name=name, camera_id=lens, image_id=numbers[name])
        given.add_image_with_trivial_frame(image, make_rigid(pose).inverse())
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = ctx.seed
    options.num_threads = 1
    options.extract_colors = False
    # Two views with a known pose are evidence enough, and small captures have little else.
    options.triangulation.ignore_two_view_tracks = False
    output = work / "triangulated"
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir()
    return pycolmap.triangulate_points(given, database, folder, output, options=options)


def make_rigid(world_from_cam: ArrayLike) -> pycolmap.Rigid3d:
    """A pose whose rotation is made orthonormal: data sets round their matrices."""
    pose = np.asarray(world_from_cam, np.float64)
    u, _, vt = np.linalg.svd(pose[:, :3])
    return pycolmap.Rigid3d(np.concatenate([u @ vt, pose[:, 3:]], 1))
