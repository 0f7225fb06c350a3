"""Cameras, lens and sparse points from a capture, undistorted frames in the normalised world, truth views beside."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pycolmap
from numpy.typing import NDArray

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import (
    Capture,
    CapturedFrame,
    LensModel,
    PosedCapture,
    PosedFrame,
    PosedTruth,
    Truth,
)
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.cameras import as_pose
from inpaint3d.scene.capture_io import (
    SparsePoints,
    read_captured_image,
    read_captured_mask,
    read_captured_valid,
    write_points,
    write_view,
)
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.pose_estimation import features
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.known import known_lens, take_other_poses
from inpaint3d.stages.pose_estimation.mapping import make_rigid
from inpaint3d.stages.pose_estimation.model import Model
from inpaint3d.stages.pose_estimation.normalise import Normalisation, normalise
from inpaint3d.stages.pose_estimation.scale import find_scale
from inpaint3d.stages.pose_estimation.solve import Solved, link_pictures, solve
from inpaint3d.stages.pose_estimation.truth import Registered, register
from inpaint3d.stages.pose_estimation.undistort import Undistorter


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Write `posed-capture`, and `posed-truth` where the capture has truth views that can be placed."""
    capture, truth = inputs.one("capture", Capture), inputs.optional("truth", Truth)
    features.silence_pycolmap()
    solved = solve(capture, config, ctx)
    world = normalise(solved.model.world_from_cam, solved.model.xyz, ctx.seed)
    write_capture(capture, solved, world, config, outputs, ctx)
    if truth is not None:
        write_truth(capture, truth, solved, world, config, outputs, ctx)


def write_capture(
    capture: Artifact[Capture], solved: Solved, world: Normalisation, config: Config, outputs: Outputs, ctx: Context
) -> None:
    """Undistorted frames, their cameras and the points between them."""
    model = solved.model.moved(world.normalised_from_source)
    flat = {number: Undistorter(lens, config.output_longest_side) for number, lens in model.lenses.items()}
    folder = outputs.folder("posed-capture")
    by_link = {solved.links[f.name]: f for f in capture.metadata.frames}
    taken = [by_link[link] for link in model.names]
    exposures = relative_exposures(taken, taken)
    tests = choose_test_views(len(taken), config)
    colours = np.zeros((len(model.track_view), 3))
    track_xy = np.zeros((len(model.track_view), 2))
    usual = describe_lens(model.lenses[max(model.lenses, key=lambda n: (model.view_lens.count(n), -n))], solved)
    frames: list[PosedFrame] = []
    for view, frame in enumerate(taken):
        ctx.progress(view, len(taken), "undistorting")
        lens = flat[model.view_lens[view]]
        image, mask = lens.image(read_captured_image(capture, frame)), read_captured_mask(capture, frame)
        rows = np.flatnonzero(model.track_view == view)
        track_xy[rows] = lens.pixels(model.track_xy[rows])
        colours[rows] = sample_bilinear(image, track_xy[rows])
        frames.append(
            write_view(
                folder, frame.name, image, lens.camera(model.world_from_cam[view]),
                split="test" if view in tests else "train", relative_exposure=exposures[view],
                mask=None if mask is None else lens.mask(mask),
                valid=lens.combine_valid(read_captured_valid(capture, frame)),
                lens=None if (own := describe_lens(lens.lens, solved)) == usual else own,
            )
        )  # fmt: skip
    write_points(folder / "points.safetensors", _make_sparse_points(model, track_xy, colours, flat))
    back = solved.local_from_source.then(world.normalised_from_source).inverse()
    scale = find_scale(capture, taken, solved.model.moved(solved.local_from_source.inverse()), config, ctx)
    outputs.write(
        "posed-capture",
        PosedCapture(
            frames=tuple(frames),
            ordered=capture.metadata.ordered,
            lens=usual,
            lens_effect=solved.lens_effect,
            registration=solved.registration,
            source_from_normalised_scale=back.scale,
            scale=None
            if scale is None
            else scale.model_copy(update={"metres_per_unit": scale.metres_per_unit * back.scale}),
            source_from_normalised=as_pose(back.matrix),
            centre_depth=world.centre_depth,
            up_evidence=world.up_evidence,
        ),
    )


def write_truth(
    capture: Artifact[Capture],
    truth: Artifact[Truth],
    solved: Solved,
    world: Normalisation,
    config: Config,
    outputs: Outputs,
    ctx: Context,
) -> None:
    """Truth views in the same world, undistorted alike; none is written where none can be placed."""
    given = truth.metadata.frames
    if solved.other_order:
        given = take_other_poses(given)
    if solved.source == "known" and all(f.camera is not None for f in given):
        model, placed = _take_known_truth(solved, given)
    else:
        paths = link_pictures(truth, solved.folder, "truth")
        model = solved.model
        placed = register(given, paths, model, solved.database, solved.folder, config, ctx)
    ctx.log(f"{len(placed)} of {len(given)} truth views could be placed")
    if not placed:
        return
    flat = {number: Undistorter(lens, config.output_longest_side) for number, lens in model.lenses.items()}
    folder = outputs.folder("posed-truth")
    there = [f for f in given if f.name in placed]
    exposures = relative_exposures(there, capture.metadata.frames)
    frames: list[PosedFrame] = []
    for frame, exposure in zip(there, exposures, strict=True):
        ctx.progress(len(frames), len(there), "truth")
        lens = flat[placed[frame.name].lens]
        camera = lens.camera(world.normalised_from_source.pose(placed[frame.name].world_from_cam))
        mask = read_captured_mask(truth, frame)
        frames.append(
            write_view(
                folder, frame.name, lens.image(read_captured_image(truth, frame)), camera, split="test",
                relative_exposure=exposure, mask=None if mask is None else lens.mask(mask),
                valid=lens.combine_valid(read_captured_valid(truth, frame)),
            )
        )  # fmt: skip
    outputs.write(
        "posed-truth",
        PosedTruth(
            frames=tuple(frames),
            registered_share=len(placed) / len(given),
            mean_reprojection_error_px=float(np.mean([p.error_px for p in placed.values()])),
        ),
    )


def describe_lens(lens: pycolmap.Camera, solved: Solved) -> LensModel:
    """A lens as the artifact has it."""
    return LensModel(model=lens.model_name, params=tuple(float(p) for p in lens.params), evidence=solved.lens_evidence)


def choose_test_views(count: int, config: Config) -> set[int]:
    """Positions of the test views: every `test_every`-th, from the first; none in captures that need all."""
    if config.test_every == 0 or count < config.keep_test_from:
        return set()
    return set(range(0, count, config.test_every))


def relative_exposures(frames: Sequence[CapturedFrame], capture: Sequence[CapturedFrame]) -> list[float | None]:
    """Each frame's exposure over the median of the capture's; None where EXIF does not say."""
    known = [e for e in (_compute_exposure(f) for f in capture) if e is not None]
    if not known:
        return [None] * len(frames)
    median = float(np.median(known))
    return [None if (e := _compute_exposure(f)) is None else e / median for f in frames]


def _compute_exposure(frame: CapturedFrame) -> float | None:
    exif = frame.exif
    if exif.exposure_s is None or exif.iso is None or exif.f_number is None:
        return None
    return exif.exposure_s * exif.iso / exif.f_number**2


def _take_known_truth(solved: Solved, frames: Sequence[CapturedFrame]) -> tuple[Model, dict[str, Registered]]:
    """Truth views with cameras of their own; their lenses join the model's. Nothing is measured: their error is 0."""
    model = solved.model
    lenses = dict(model.lenses)
    placed: dict[str, Registered] = {}
    for frame in frames:
        if (camera := frame.camera) is None:
            continue
        lens = known_lens(max(lenses) + 1, frame, camera)
        alike = (n for n, c in lenses.items() if c.params_to_string() == lens.params_to_string()
                 and (c.model_name, c.width, c.height) == (lens.model_name, lens.width, lens.height))  # fmt: skip
        number = next(alike, lens.camera_id)
        lenses.setdefault(number, lens)
        pose = make_rigid(solved.local_from_source.pose(camera.world_from_cam)).matrix()
        placed[frame.name] = Registered(pose, number, 0.0)
    return replace(model, lenses=lenses), placed


def _make_sparse_points(
    model: Model, track_xy: NDArray[np.float64], colours: NDArray[np.float64], flat: dict[int, Undistorter]
) -> SparsePoints:
    """The points with tracks in undistorted pixels, mean colours, and errors at the output size."""
    count = len(model.xyz)
    lengths = np.maximum(np.diff(model.track_offsets), 1)
    mean = np.stack([np.bincount(model.track_point, colours[:, c], count) / lengths for c in range(3)], 1)
    shrink = max(u.width / u.lens.width for u in flat.values())
    return SparsePoints(
        xyz=model.xyz.astype(np.float32),
        rgb=np.rint(mean * 255).astype(np.uint8),
        error=(model.error * shrink).astype(np.float32),
        track_offsets=model.track_offsets,
        track_frame=model.track_view.astype(np.int32),
        track_xy=track_xy.astype(np.float32),
    )
