"""A capture's cameras: those that came with it, triangulated, or estimated from its pictures. Both pass the gate."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pycolmap

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, KnownCamera, Registration, Truth
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.geometry import Similarity
from inpaint3d.stages.pose_estimation import features, gate, lens, mapping
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.model import Model, from_reconstruction, median_triangulation_angle
from inpaint3d.stages.pose_estimation.normalise import find_local_frame

START_LENS = "SIMPLE_RADIAL"


@dataclass(frozen=True, eq=False)
class Solved:
    """A model that passed the gate. `links`: frame name -> its picture's path below `folder`, the name in the model.

    local_from_source: from the world of known cameras to the model's; estimated ones have no other than the model's.
    """

    model: Model
    source: Literal["estimated", "known"]
    lens_evidence: str
    evidence: gate.Evidence
    database: Path
    folder: Path
    links: dict[str, str]
    local_from_source: Similarity

    @property
    def registration(self) -> Registration:
        e = self.evidence
        return Registration(
            source=self.source,
            given=e.given,
            registered=e.registered,
            unregistered=e.unregistered,
            mean_reprojection_error_px=e.error_px,
            points=e.points,
            median_triangulation_angle_deg=e.angle_deg,
        )


def solve(capture: Artifact[Capture], config: Config, ctx: Context) -> Solved:
    """Cameras and points of a capture in its source's world; BadInputError where the gate refuses."""
    known = _use_known(capture.metadata, config)
    folder = ctx.work / "pictures"
    links = link_pictures(capture, folder, "capture")
    groups, lenses = _known_lenses(capture.metadata) if known else _size_groups(capture.metadata, config)
    database = ctx.work / "capture.db"
    features.create_database(database, list(lenses.values()))
    by_lens = {number: [links[f.name] for f in frames] for number, frames in groups.items()}
    features.add_pictures(database, folder, by_lens, config, ctx)
    order = list(links.values())
    local = _find_local_frame(capture.metadata) if known else Similarity(1.0, np.eye(3), np.zeros(3))
    pairs = features.choose_pairs(order, ordered=capture.metadata.ordered, config=config)
    features.match(database, pairs, ctx)
    if known:
        cameras = {
            links[f.name]: (n, local.pose(f.camera.world_from_cam))
            for n, frames in groups.items()
            for f in frames
            if f.camera
        }
        found = mapping.triangulate(database, folder, ctx.work, lenses, cameras, ctx)
        model, sizes = from_reconstruction(found, order), [len(order)]
        why = "came with the capture"
    else:
        result = mapping.estimate(database, folder, ctx.work, config, ctx)
        sizes = result.sizes
        if result.model is None:
            gate.check_estimated(_evidence(None, sizes, capture.metadata, links, database), config)
            raise BadInputError("no model could be made of the photos; take more that overlap")
        ctx.progress(len(order), len(order), "lens")
        chosen, why = lens.choose_lens(result.model, config.lens)
        model = from_reconstruction(chosen, order)
    evidence = _evidence(model, sizes, capture.metadata, links, database)
    (gate.check_known if known else gate.check_estimated)(evidence, config)
    return Solved(model, "known" if known else "estimated", why, evidence, database, folder, links, local)


def _find_local_frame(capture: Capture) -> Similarity:
    return find_local_frame(np.array([f.camera.world_from_cam for f in capture.frames if f.camera])[:, :, 3])


def link_pictures(artifact: Artifact[Capture] | Artifact[Truth], folder: Path, kind: str) -> dict[str, str]:
    """Links named by number, since lists of pairs can't hold names with spaces; frame name -> path below `folder`."""
    links: dict[str, str] = {}
    (folder / kind).mkdir(parents=True, exist_ok=True)
    for i, frame in enumerate(artifact.metadata.frames):
        links[frame.name] = f"{kind}/{i:05d}{Path(frame.path).suffix}"
        link = folder / links[frame.name]
        link.unlink(missing_ok=True)
        link.symlink_to((artifact.root / frame.path).resolve())
    return links


def _use_known(capture: Capture, config: Config) -> bool:
    having = [f for f in capture.frames if f.camera is not None]
    if config.cameras == "estimate" or (config.cameras == "auto" and not having):
        return False
    if len(having) == len(capture.frames):
        return True
    missing = next(f.name for f in capture.frames if f.camera is None)
    raise BadInputError(
        f"{len(having)} of {len(capture.frames)} frames came with a camera, {missing} did not; "
        "set pose-estimation.cameras=estimate, or give cameras for all"
    )


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


Groups = dict[int, list[CapturedFrame]]


def _known_lenses(capture: Capture) -> tuple[Groups, dict[int, pycolmap.Camera]]:
    """Frames by lens, equal lenses shared."""
    numbers: dict[tuple[object, ...], int] = {}
    groups: Groups = {}
    lenses: dict[int, pycolmap.Camera] = {}
    for frame in capture.frames:
        if (camera := frame.camera) is None:
            continue
        number = numbers.setdefault((camera.model, camera.params, frame.width, frame.height), len(numbers) + 1)
        groups.setdefault(number, []).append(frame)
        lenses.setdefault(number, known_lens(number, frame, camera))
    return groups, lenses


def _size_groups(capture: Capture, config: Config) -> tuple[Groups, dict[int, pycolmap.Camera]]:
    """Frames by size: one lens is estimated for each."""
    sizes: dict[tuple[int, int], int] = {}
    groups: Groups = {}
    for frame in capture.frames:
        groups.setdefault(sizes.setdefault((frame.width, frame.height), len(sizes) + 1), []).append(frame)
    start = START_LENS if config.lens == "auto" else config.lens
    return groups, {n: features.guess_camera(n, frames, start) for n, frames in groups.items()}


def _evidence(
    model: Model | None, sizes: list[int], capture: Capture, links: dict[str, str], database: Path
) -> gate.Evidence:
    placed = set(model.names) if model else set()
    pairs, turned, inliers = mapping.two_view_kinds(database)
    residuals = model.residuals() if model else np.zeros(0)
    return gate.Evidence(
        given=len(capture.frames),
        registered=len(placed),
        unregistered=tuple(f.name for f in capture.frames if links[f.name] not in placed),
        model_sizes=sizes,
        verified_pairs=pairs,
        turned_pairs=turned,
        median_inliers=inliers,
        points=len(model.xyz) if model else 0,
        angle_deg=median_triangulation_angle(model) if model else 0.0,
        error_px=float(residuals.mean()) if residuals.size else 0.0,
        longest_side=max(max(f.width, f.height) for f in capture.frames),
    )
