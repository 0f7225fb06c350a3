"""Captures as people should not have them: what is said of each, where, and after how many CPU seconds.

python -m benchmarks.captures [--scene NAME=FOLDER ...] [--every 2] [--study cameras] [--study photos] ...

Scenes are folders with cameras (nerfstudio, LLFF); without one, the demo capture with the renderer's cameras. Studies:
`cameras` scrambles those that came with the scene, `mixed` puts photos of another scene among its own, with and without
cameras, `degenerate` makes captures without depth of its photos, `photos` estimates the cameras of all its photos and
compares their rotations with those that came, `field` fits one under scrambled cameras with the gate of pose-estimation
open, to see what is said then. But for `photos`, pictures are reduced to 480 pixels, and every so many are taken.
Features and matches are found once for scrambles that leave pictures alone; their time is in each row. Rows are kept
in benchmarks/results/captures.json, and as a table in captures.md, until they are measured again.
"""

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from benchmarks.provenance import REPOSITORY, commit
from benchmarks.scrambles import SCRAMBLED_CAMERAS, Frames, degenerate_photos, mix_scenes

from inpaint3d.contracts.errors import BadInputError, Inpaint3dError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.kit.shim import execute
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, KnownCamera, PosedCapture, Source
from inpaint3d.contracts.store import Artifact, FolderStore, Record
from inpaint3d.scene.image_io import read_image, write_png
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.features import silence_pycolmap
from inpaint3d.stages.pose_estimation.solve import Solved, solve

SIDE = 480
RESULTS = REPOSITORY / "benchmarks" / "results" / "captures.json"
STAGES, BY = "inpaint3d.stages.", "pose-estimation"
OPEN_GATE = {"min_agreement": 0, "min_view_agreement": 0, "largest_error_px": 1000, "min_points": 1}
QUICK_FIELD = {"steps": 400, "view_side": 64}  # preset draft's


@dataclass(frozen=True)
class Row:
    """What came of one capture. `good`: whether it should have passed."""

    scene: str
    capture: str
    good: bool
    where: str
    said: str
    cpu_s: float
    passed: bool


def take_in(store: FolderStore, folder: Path, name: str) -> Artifact[Capture]:
    """The folder as capture-ingest takes it."""
    place = store.private_folder()
    shutil.copytree(folder, place / "raw")
    source = store.put(place, "source", Source(name=name, kind="folder"))
    record = execute(f"{STAGES}capture_ingest", store, Invocation(inputs={"source": source}, threads=1), StringIO())
    return store.open(record.outputs["capture"], Capture)


def reduce(store: FolderStore, whole: Artifact[Capture], every: int) -> Artifact[Capture]:
    """Every so many frames, reduced to `SIDE` pixels, cameras with them."""
    frames = list(whole.metadata.frames)[::every]
    factor = min(1.0, SIDE / max(frames[0].width, frames[0].height))
    pictures = [
        cv2.resize(p, (round(p.shape[1] * factor), round(p.shape[0] * factor)), interpolation=cv2.INTER_AREA)
        for p in (read_image(whole.path(f.path)) for f in frames)
    ]
    cameras = [f.camera and f.camera.model_copy(update={"params": _scaled(f.camera.params, factor)}) for f in frames]
    return put(store, pictures, cameras, ordered=whole.metadata.ordered)


def _pictures(artifact: Artifact[Capture]) -> list[np.ndarray]:
    return [read_image(artifact.path(f.path)) for f in artifact.metadata.frames]


def _scaled(params: tuple[float, ...], factor: float) -> tuple[float, ...]:
    return (*(p * factor for p in params[:4]), *params[4:])  # PINHOLE and OPENCV


def put(
    store: FolderStore, pictures: list[np.ndarray], cameras: Sequence[KnownCamera | None], *, ordered: bool
) -> Artifact[Capture]:
    """Pictures, with their cameras where there are any, as a capture."""
    place = store.private_folder()
    frames: Frames = []
    for i, (picture, camera) in enumerate(zip(pictures, cameras, strict=True)):
        name, (height, width) = f"f_{i:03d}", picture.shape[:2]
        write_png(place / f"frames/{name}.png", picture)
        frames.append(CapturedFrame(name=name, path=f"frames/{name}.png", width=width, height=height, camera=camera))
    metadata = Capture(layout="photos", ordered=ordered, frames=tuple(frames))
    return store.open(store.put(place, "capture", metadata), Capture)


def with_frames(store: FolderStore, artifact: Artifact[Capture], frames: Frames) -> Artifact[Capture]:
    place = store.private_folder()
    shutil.copytree(artifact.root / "frames", place / "frames")
    metadata = artifact.metadata.model_copy(update={"frames": tuple(frames)})
    return store.open(store.put(place, "capture", metadata), Capture)


def judge(
    artifact: Artifact[Capture], work: Path, *, database: Path | None = None, config: Config | None = None
) -> tuple[str, Solved | None, float]:
    """What pose-estimation says, what it found, CPU seconds; with a snapshot of a database, what is in it."""
    work.mkdir(parents=True)
    if database is not None:
        shutil.copyfile(database, work / database.name)
    logged: list[str] = []

    def emit(event: str, **values: object) -> None:
        if event == "log":
            logged.append(str(values["message"]))

    began = time.process_time()
    ctx = Context(seed=0, device="cpu", threads=1, work=work, emit=emit)
    try:
        solved = solve(artifact, config or Config(), ctx)
    except BadInputError as refusal:
        return " / ".join([*logged, str(refusal)]), None, time.process_time() - began
    r = solved.registration
    said = (
        f"{r.registered} of {r.given} views, {r.agreement:.1%} of matches agree, {r.mean_reprojection_error_px:.2f} px"
    )
    return " / ".join([*logged, said]), solved, time.process_time() - began


def rotation_errors(solved: Solved, frames: Sequence[CapturedFrame]) -> np.ndarray:
    """Degrees [registered] between the rotations found and those that came, after the turn that fits them best."""
    number = {solved.links[f.name]: i for i, f in enumerate(frames)}
    came = [np.array(c.world_from_cam)[:, :3] for f in frames if (c := f.camera)]
    pairs = [
        (pose[:, :3], came[number[n]]) for n, pose in zip(solved.model.names, solved.model.world_from_cam, strict=True)
    ]
    u, _, vt = np.linalg.svd(sum(theirs @ ours.T for ours, theirs in pairs))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    vectors = [cv2.Rodrigues(theirs.T @ turn @ ours)[0] for ours, theirs in pairs]
    return np.rad2deg([float(np.linalg.norm(v)) for v in vectors])


def study_cameras(store: FolderStore, scene: str, artifact: Artifact[Capture], work: Path) -> Iterator[Row]:
    said, passed, shared = judge(artifact, work / "right")
    yield Row(scene, "the cameras as they are", True, BY, said, round(shared, 1), passed is not None)
    database = work / "right" / "capture.db.safetensors"
    _, _, solving = judge(artifact, work / "again", database=database)
    for name, scramble in SCRAMBLED_CAMERAS.items():
        scrambled = with_frames(store, artifact, scramble(list(artifact.metadata.frames)))
        said, passed, own = judge(scrambled, work / name.replace("/", " "), database=database)
        yield Row(scene, name, False, BY, said, round(shared - solving + own, 1), passed is not None)


def study_mixed(store: FolderStore, scene: str, artifact: Artifact[Capture], work: Path) -> Iterator[Row]:
    mixed = mix_scenes(_pictures(artifact), other_scene(scene))
    cameras = [f.camera for f in artifact.metadata.frames]
    for name, known in (("cameras known", cameras), ("without cameras", [None] * len(cameras))):
        taken = put(store, mixed, known, ordered=artifact.metadata.ordered)
        said, passed, cpu = judge(taken, work / f"mixed {name}")
        what = f"half the photos of another scene, {name}"
        yield Row(scene, what, False, BY, said, round(cpu, 1), passed is not None)


def other_scene(scene: str) -> list[np.ndarray]:
    """Photos of the demo capture, or for that of the synthetic room."""
    if scene == "demo":
        return list(synthetic_scene(8, 320, 240).images)
    return [read_image(p) for p in sorted((REPOSITORY / "examples/demo/capture/images").glob("*.jpg"))[::3]]


def study_degenerate(store: FolderStore, scene: str, artifact: Artifact[Capture], work: Path) -> Iterator[Row]:
    for name, pictures in degenerate_photos(_pictures(artifact)):
        taken = put(store, pictures, [None] * len(pictures), ordered=artifact.metadata.ordered)
        said, passed, cpu = judge(taken, work / f"photos {name}")
        yield Row(scene, f"{name}, without cameras", False, BY, said, round(cpu, 1), passed is not None)


def study_photos(_: FolderStore, scene: str, whole: Artifact[Capture], work: Path) -> Iterator[Row]:
    """Every photo at its own size, as a person gives them."""
    said, solved, cpu = judge(whole, work / "photos alone", config=Config(cameras="estimate"))
    if solved is not None:
        off = rotation_errors(solved, whole.metadata.frames)
        said += f", rotations off by a median of {np.median(off):.3f} degrees, at most {off.max():.2f}"
    yield Row(scene, "the photos, without cameras", True, BY, said, round(cpu, 1), solved is not None)


def study_field(store: FolderStore, scene: str, artifact: Artifact[Capture], _: Path) -> Iterator[Row]:
    """What nerf-pretraining says of scrambled cameras that nobody held to their pictures."""
    chosen = {"the cameras as they are": list, **{n: SCRAMBLED_CAMERAS[n] for n in (
        "cameras in the order of names as text", "mirrored poses", "focal length 30 % too long")}}  # fmt: skip
    for name, scramble in chosen.items():
        scrambled = with_frames(store, artifact, scramble(list(artifact.metadata.frames)))
        began = time.process_time()
        try:
            doubts, figures = _fit(store, scrambled)
        except Inpaint3dError as error:
            doubts, figures = (str(error),), "no field"
        yield Row(
            scene, f"{name}, the gate open", name == "the cameras as they are", "nerf-pretraining",
            "; ".join([figures, *doubts]), round(time.process_time() - began, 1), not doubts,
        )  # fmt: skip


def _fit(store: FolderStore, artifact: Artifact[Capture]) -> tuple[tuple[str, ...], str]:
    from inpaint3d.contracts.models.artifacts import RadianceFieldArtifact

    made = _stage(store, "pose_estimation", {"capture": artifact.digest}, OPEN_GATE)
    posed = made.outputs["posed-capture"]
    plan = _stage(store, "scene_analysis", {"posed-capture": posed}, {}).outputs["effect-plan"]
    record = _stage(store, "nerf_pretraining", {"posed-capture": posed, "effect-plan": plan}, QUICK_FIELD)
    f = store.open(record.outputs["radiance-field"], RadianceFieldArtifact).metadata
    r = store.open(posed, PosedCapture).metadata.registration
    return record.doubts, (
        f"poses {r.agreement:.0%}, {r.mean_reprojection_error_px:.2f} px; field {f.held_out_psnr:.1f} dB, "
        f"depth {f.depth_error:.1%}, floaters {f.floaters:.1%}"
    )


def _stage(store: FolderStore, name: str, inputs: dict[str, Any], parameters: dict[str, Any]) -> Record:
    return execute(f"{STAGES}{name}", store, Invocation(inputs=inputs, parameters=parameters, threads=1), StringIO())


def write_demo(folder: Path, every: int = 3) -> Path:
    """The demo capture's photos with the renderer's cameras, as nerfstudio has them."""
    demo = REPOSITORY / "examples" / "demo"
    truth = json.loads((demo / "renderer" / "cameras.json").read_text())
    focal, cx, cy, k1 = truth["params"]
    (folder / "images").mkdir(parents=True)
    frames = []
    for camera in truth["images"]:
        photo = demo / "capture" / "images" / f"{camera['name']}.jpg"
        if photo.is_file() and int(camera["name"].rpartition("_")[2]) % every == 0:
            shutil.copyfile(photo, folder / "images" / photo.name)
            pose = np.vstack([camera["world_from_cam"], [0, 0, 0, 1]]) @ np.diag([1.0, -1, -1, 1])
            frames.append({"file_path": f"images/{photo.name}", "transform_matrix": pose.tolist()})
    top = {"fl_x": focal, "fl_y": focal, "cx": cx, "cy": cy, "k1": k1, "w": truth["width"], "h": truth["height"]}
    (folder / "transforms.json").write_text(json.dumps({**top, "frames": frames}))
    return folder


def write_rows(rows: Sequence[Row]) -> None:
    """The figures, and the table that a person reads."""
    RESULTS.write_text(json.dumps({**commit(), "rows": [asdict(r) for r in rows]}, indent=1) + "\n")
    lines = ["| scene | capture | | by | what is said | CPU s |", "|---|---|---|---|---|---|"]
    for row in rows:
        cells = (row.scene, row.capture, "passes" if row.passed else "stopped", row.where, row.said, row.cpu_s)
        lines.append(f"| {' | '.join(map(str, cells))} |")
    RESULTS.with_suffix(".md").write_text("\n".join(lines) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", action="append", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--every", type=int, default=1, help="take every so many frames of a scene")
    parser.add_argument("--study", action="append", choices=STUDIES, help="default: cameras")
    given = parser.parse_args()
    silence_pycolmap()
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        store = FolderStore(work / "store")
        folders = {n: Path(f) for n, f in (s.split("=", 1) for s in given.scene)} or {
            "demo": write_demo(work / "demo-capture")
        }
        for scene, folder in folders.items():
            whole = take_in(store, folder, scene)
            small = reduce(store, whole, given.every)
            for study in given.study or ["cameras"]:
                keep(STUDIES[study](store, scene, whole if study == "photos" else small, work / scene))


def keep(found: Iterable[Row]) -> None:
    """Each row as soon as it is there, in the place of an earlier one."""
    for row in found:
        rows = [Row(**r) for r in json.loads(RESULTS.read_text())["rows"]] if RESULTS.is_file() else []
        kept = [r for r in rows if (r.scene, r.capture) != (row.scene, row.capture)]
        write_rows([*kept, row])
        wrong = sum(r.passed != r.good for r in [*kept, row])
        print(f"{row}\n{len(kept) + 1} captures, {wrong} judged wrongly", flush=True)


STUDIES = {
    "cameras": study_cameras, "mixed": study_mixed, "degenerate": study_degenerate, "photos": study_photos,
    "field": study_field,
}  # fmt: skip


if __name__ == "__main__":
    main()
