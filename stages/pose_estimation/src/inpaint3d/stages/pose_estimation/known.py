"""Cameras that came with a capture: their lenses, the order that their pictures support, and whether they agree."""

from collections.abc import Sequence

import numpy as np
import pycolmap

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import CapturedFrame, KnownCamera
from inpaint3d.stages.pose_estimation import gate
from inpaint3d.stages.pose_estimation.agreement import Agreement, Cameras, measure_agreement
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.mapping import make_rigid
from inpaint3d.stages.pose_estimation.matches import VerifiedPair
from inpaint3d.stages.pose_estimation.suspects import find_repair

Groups = dict[int, list[CapturedFrame]]


def known_lens(number: int, frame: CapturedFrame, camera: KnownCamera) -> pycolmap.Camera:
    """The lens of a frame that came with a camera."""
    made = pycolmap.Camera.create_from_model_name(number, camera.model, 1.0, frame.width, frame.height)
    if len(camera.params) != len(made.params):
        raise BadInputError(
            f"camera of {frame.name}: {camera.model} has {len(made.params)} parameters, not {len(camera.params)}"
        )
    made.params = list(camera.params)
    made.has_prior_focal_length = True
    return made


def group_by_lens(frames: Sequence[CapturedFrame]) -> tuple[Groups, dict[int, pycolmap.Camera]]:
    """Frames by lens, equal lenses shared."""
    numbers: dict[tuple[object, ...], int] = {}
    groups: Groups = {}
    lenses: dict[int, pycolmap.Camera] = {}
    for frame in frames:
        if (camera := frame.camera) is None:
            continue
        number = numbers.setdefault((camera.model, camera.params, frame.width, frame.height), len(numbers) + 1)
        groups.setdefault(number, []).append(frame)
        lenses.setdefault(number, known_lens(number, frame, camera))
    return groups, lenses


def take_other_poses(frames: Sequence[CapturedFrame]) -> tuple[CapturedFrame, ...]:
    """The frames with the poses that they have if the document's rows are in the other order."""
    return tuple(
        frame.model_copy(update={"camera": frame.camera.model_copy(update={"world_from_cam": frame.other_pose})})
        if frame.camera is not None and frame.other_pose is not None
        else frame
        for frame in frames
    )


def choose_order(
    frames: Sequence[CapturedFrame], pairs: Sequence[VerifiedPair], config: Config, ctx: Context
) -> tuple[tuple[CapturedFrame, ...], bool]:
    """The frames with the poses that verified matches support better, and whether these are the other ones."""
    given = tuple(frames)
    if all(frame.other_pose is None for frame in frames):
        return given, False
    other = take_other_poses(frames)
    as_text, as_numbers = (_measure_agreement(f, pairs, config).share for f in (given, other))
    better = "numbers" if as_numbers > as_text else "text"
    ctx.log(
        f"cameras without names: with the pictures in the order of their names as text {as_text:.0%} of the verified "
        f"matches agree with them, as numbers {as_numbers:.0%}; the order as {better} is taken"
    )
    return (other, True) if as_numbers > as_text else (given, False)


def check(
    frames: Sequence[CapturedFrame], pairs: Sequence[VerifiedPair], features: Sequence[int], config: Config
) -> None:
    """BadInputError where pictures contradict their cameras or show nothing. `features`: how many each picture has."""
    names = [frame.name for frame in frames]
    gate.check_blank([name for name, count in zip(names, features, strict=True) if count < gate.BLANK])
    cameras = _collect_cameras(frames)
    gate.check_spread(np.array([pose[:, 3] for pose in cameras.world_from_cam]), names)
    if config.min_agreement > 0:
        repair = find_repair(pairs, cameras, tolerance(config))
        gate.check_agreement(_measure_agreement(frames, pairs, config), repair, frames, config)


def tolerance(config: Config) -> float:
    """How far a match may be from its epipolar line, as a share of the longest side."""
    return config.largest_epipolar_px / 1000


def _collect_cameras(frames: Sequence[CapturedFrame]) -> Cameras:
    having = [(frame, frame.camera) for frame in frames if frame.camera is not None]
    return Cameras(
        [known_lens(1, frame, camera) for frame, camera in having],
        [make_rigid(camera.world_from_cam).matrix() for _, camera in having],
    )


def _measure_agreement(frames: Sequence[CapturedFrame], pairs: Sequence[VerifiedPair], config: Config) -> Agreement:
    return measure_agreement(pairs, _collect_cameras(frames), tolerance(config))
