"""A capture's cameras: those that came with it, triangulated, or estimated from its pictures. Both pass the gate."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pycolmap

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, Effect, Registration, Truth
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.geometry import Similarity
from inpaint3d.stages.pose_estimation import features, gate, known, lens, mapping
from inpaint3d.stages.pose_estimation.agreement import Agreement, Cameras, measure_agreement
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.matches import VerifiedPair, count_kinds, read_verified_pairs
from inpaint3d.stages.pose_estimation.model import Model, from_reconstruction, median_triangulation_angle
from inpaint3d.stages.pose_estimation.normalise import find_local_frame

START_LENS = "SIMPLE_RADIAL"
SOURCE = Similarity(1.0, np.eye(3), np.zeros(3))
# The second try: more and finer features, all pairs of sets up to so many frames, and matches along epipolar lines.
FEATURES_FACTOR, SIDE_FACTOR, EXHAUSTIVE_UP_TO = 2, 1.5, 120


@dataclass(frozen=True, eq=False)
class Solved:
    """A model that passed the gate. `links`: frame name -> its picture's path below `folder`, the name in the model.

    local_from_source: from the world of known cameras to the model's; estimated ones have no other than the model's.
    """

    model: Model
    source: Literal["estimated", "known"]
    lens_evidence: str
    lens_effect: Effect
    evidence: gate.Evidence
    agreement: Agreement
    database: Path
    folder: Path
    links: dict[str, str]
    local_from_source: Similarity
    other_order: bool = False
    """Whether cameras without names were taken in the other order of their pictures."""

    @property
    def registration(self) -> Registration:
        e = self.evidence
        return Registration(
            source=self.source,
            given=e.given,
            registered=e.registered,
            unregistered=e.unregistered,
            mean_reprojection_error_px=e.error_px,
            agreement=self.agreement.share,
            points=e.points,
            median_triangulation_angle_deg=e.angle_deg,
        )


@dataclass(frozen=True, eq=False)
class Matched:
    """A capture's pictures with their features and verified matches. `features`: how many each picture has."""

    frames: Sequence[CapturedFrame]
    links: dict[str, str]
    folder: Path
    database: Path
    pairs: list[VerifiedPair]
    features: list[int]

    @property
    def order(self) -> list[str]:
        return list(self.links.values())


def solve(capture: Artifact[Capture], config: Config, ctx: Context) -> Solved:
    """Cameras and points of a capture in its source's world; BadInputError where the gate refuses.

    Where too few views can be placed, a second try looks harder before that.
    """
    if _use_known(capture.metadata, config):
        return _solve_known(capture, config, ctx)
    try:
        return _estimate(capture, config, ctx, ctx.work)
    except gate.TooFewViewsError as refusal:
        harder = look_harder(config, len(capture.metadata.frames))
        ctx.log(
            f"{refusal}. A second try: {harder.features} features at {harder.feature_longest_side} px, "
            f"{harder.matching} matching, guided"
        )
    return _estimate(capture, harder, ctx, ctx.work / "second", guided=True)


def look_harder(config: Config, frames: int) -> Config:
    """Parameters that find more, and cost several times as much."""
    return config.model_copy(
        update={
            "features": FEATURES_FACTOR * config.features,
            "feature_longest_side": round(SIDE_FACTOR * config.feature_longest_side),
            "matching": "exhaustive" if frames <= EXHAUSTIVE_UP_TO else config.matching,
            "overlap": 2 * config.overlap,
        }
    )


def _solve_known(capture: Artifact[Capture], config: Config, ctx: Context) -> Solved:
    if config.force:
        raise ConfigurationError(
            "lens-distortion cannot be switched: the lens came with the capture; set pose-estimation.cameras=estimate"
        )
    groups, lenses = known.group_by_lens(capture.metadata.frames)
    matched = _match_pictures(capture, groups, lenses, config, ctx, ctx.work)
    frames, other = known.choose_order(matched.frames, matched.pairs, config, ctx)
    known.check(frames, matched.pairs, matched.features, config)
    number = {f.name: n for n, group in groups.items() for f in group}
    local = find_local_frame(np.array([f.camera.world_from_cam for f in frames if f.camera])[:, :, 3])
    cameras = {matched.links[f.name]: (number[f.name], local.pose(f.camera.world_from_cam)) for f in frames if f.camera}
    found = mapping.triangulate(matched.database, matched.folder, ctx.work, lenses, cameras, ctx)
    model = from_reconstruction(found, matched.order)
    evidence = _collect_evidence(model, [len(frames)], matched)
    gate.check_known(evidence, config)
    decided = "came with the capture", lens.describe_given(lenses.values())
    return _conclude(model, "known", decided, evidence, matched, config, local, other_order=other)


def _estimate(capture: Artifact[Capture], config: Config, ctx: Context, work: Path, *, guided: bool = False) -> Solved:
    work.mkdir(exist_ok=True)
    groups, lenses = group_by_camera(capture.metadata.frames, START_LENS if config.lens == "auto" else config.lens)
    matched = _match_pictures(capture, groups, lenses, config, ctx, work, guided=guided)
    result = mapping.estimate(matched.database, matched.folder, work, config, ctx)
    if result.model is None:
        gate.check_estimated(_collect_evidence(None, result.sizes, matched), config)
        raise BadInputError("no model could be made of the photos; take more that overlap")
    ctx.progress(len(matched.order), len(matched.order), "lens")
    choice = lens.choose_lens(result.model, config.lens, config.force.get("lens-distortion"))
    model = from_reconstruction(choice.model, matched.order)
    evidence = _collect_evidence(model, result.sizes, matched)
    gate.check_estimated(evidence, config)
    solved = _conclude(model, "estimated", (choice.why, choice.effect), evidence, matched, config)
    gate.check_found(solved.agreement, config)
    frame_of = {link: name for name, link in matched.links.items()}
    gate.check_spread(model.centres, [frame_of[link] for link in model.names])
    return solved


def _conclude(
    model: Model,
    source: Literal["estimated", "known"],
    decided: tuple[str, Effect],
    evidence: gate.Evidence,
    matched: Matched,
    config: Config,
    local: Similarity = SOURCE,
    *,
    other_order: bool = False,
) -> Solved:
    pairs = read_verified_pairs(matched.database, model.names)
    cameras = Cameras([model.lenses[n] for n in model.view_lens], list(model.world_from_cam))
    agreement = measure_agreement(pairs, cameras, known.tolerance(config))
    return Solved(
        model,
        source,
        *decided,
        evidence,
        agreement,
        matched.database,
        matched.folder,
        matched.links,
        local,
        other_order,
    )


def _match_pictures(
    capture: Artifact[Capture],
    groups: known.Groups,
    lenses: dict[int, pycolmap.Camera],
    config: Config,
    ctx: Context,
    work: Path,
    *,
    guided: bool = False,
) -> Matched:
    folder, database = ctx.work / "pictures", work / "capture.db"
    links = link_pictures(capture, folder, "capture")
    order = list(links.values())
    features.create_database(database, list(lenses.values()))
    by_lens = {number: [links[f.name] for f in frames] for number, frames in groups.items()}
    features.add_pictures(database, folder, by_lens, config, ctx)
    pairs = features.choose_pairs(order, ordered=capture.metadata.ordered, config=config)
    features.match(database, pairs, ctx, guided=guided)
    with pycolmap.Database.open(database) as db:
        counts = [len(features.features_of(db, name)) for name in order]
    return Matched(capture.metadata.frames, links, folder, database, read_verified_pairs(database, order), counts)


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


def group_by_camera(frames: Sequence[CapturedFrame], model: str) -> tuple[known.Groups, dict[int, pycolmap.Camera]]:
    """Frames that one lens took: of one camera, size and focal length, as far as EXIF says; a lens for each group."""
    numbers: dict[tuple[object, ...], int] = {}
    groups: known.Groups = {}
    for frame in frames:
        key = (frame.exif.camera, frame.exif.focal_px, frame.width, frame.height)
        groups.setdefault(numbers.setdefault(key, len(numbers) + 1), []).append(frame)
    return groups, {n: features.guess_camera(n, group, model) for n, group in groups.items()}


def _collect_evidence(model: Model | None, sizes: list[int], matched: Matched) -> gate.Evidence:
    placed = set(model.names) if model else set()
    residuals = model.residuals() if model else np.zeros(0)
    longest_side = max(max(f.width, f.height) for f in matched.frames)
    return gate.Evidence(
        given=len(matched.frames),
        registered=len(placed),
        unregistered=tuple(f.name for f in matched.frames if matched.links[f.name] not in placed),
        model_sizes=sizes,
        pairs=count_kinds(matched.pairs, longest_side),
        median_features=float(np.median(matched.features)),
        points=len(model.xyz) if model else 0,
        angle_deg=median_triangulation_angle(model) if model else 0.0,
        error_px=float(residuals.mean()) if residuals.size else 0.0,
        longest_side=longest_side,
    )
