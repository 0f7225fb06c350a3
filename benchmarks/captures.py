"""Captures as people should not have them: what is said of each, where, and after how many CPU seconds.

python -m benchmarks.captures [--scene NAME=FOLDER ...] [--study cameras] [--study photos] [--study field]

Scenes are folders with cameras (nerfstudio, LLFF); the demo capture with the renderer's cameras is always one. Pictures
are reduced to 480 pixels. Features and matches are found once for all scrambles of a scene that leave its pictures
alone; their time is in each row. Studies: `cameras` scrambles those that came with the scene; `photos` scrambles the
pictures, whose cameras are to be estimated; `field` fits one under scrambled cameras with the gate of pose-estimation
open, to see what is said then. Rows are kept in benchmarks/results/captures.json, and as a table in captures.md, until
they are measured again.
"""

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from benchmarks.provenance import REPOSITORY, commit

from inpaint3d.contracts.errors import BadInputError, Inpaint3dError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.kit.shim import execute
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, KnownCamera, PosedCapture, Source
from inpaint3d.contracts.store import Artifact, FolderStore, Record
from inpaint3d.scene.cameras import as_pose
from inpaint3d.scene.image_io import read_image, write_png
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.features import silence_pycolmap
from inpaint3d.stages.pose_estimation.solve import solve

SIDE = 480
RESULTS = REPOSITORY / "benchmarks" / "results" / "captures.json"
STAGES = "inpaint3d.stages."
OPEN_GATE = {"min_agreement": 0, "min_view_agreement": 0, "largest_error_px": 1000, "min_points": 1}
QUICK_FIELD = {"steps": 400, "view_side": 64}  # preset draft's

Frames = list[CapturedFrame]
Scramble = Callable[[Frames], Frames]


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


# Cameras, scrambled: poses are world_from_cam.


def _with_poses(frames: Frames, change: Callable[[int, np.ndarray], np.ndarray]) -> Frames:
    poses = [np.array(f.camera.world_from_cam) if f.camera else np.eye(4)[:3] for f in frames]
    moved = [as_pose(change(i, pose)) for i, pose in enumerate(poses)]
    return [
        f.model_copy(update={"camera": f.camera.model_copy(update={"world_from_cam": pose})}) if f.camera else f
        for f, pose in zip(frames, moved, strict=True)
    ]


def _reorder(order: Callable[[int], list[int]]) -> Scramble:
    def scramble(frames: Frames) -> Frames:
        chosen = order(len(frames))
        return [f.model_copy(update={"camera": frames[i].camera}) for f, i in zip(frames, chosen, strict=True)]

    return scramble


def _scale_focal(factor: float) -> Scramble:
    def scramble(frames: Frames) -> Frames:
        changed: Frames = []
        for f in frames:
            camera = f.camera
            if camera is not None:
                count = 1 if camera.model.startswith("SIMPLE") or camera.model == "RADIAL" else 2
                params = (*(p * factor for p in camera.params[:count]), *camera.params[count:])
                camera = camera.model_copy(update={"params": params})
            changed.append(f.model_copy(update={"camera": camera}))
        return changed

    return scramble


def _turn(pose: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.concatenate([left @ pose[:, :3] @ right, left @ pose[:, 3:]], 1)


MIRROR, OPENGL = np.diag([-1.0, 1, 1]), np.diag([1.0, -1, -1])
QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
SCRAMBLED_CAMERAS: dict[str, Scramble] = {
    "cameras in the order of names as text": _reorder(lambda n: sorted(range(n), key=lambda i: f"f_{i}")),
    "each the next one's camera": _reorder(lambda n: [(i + 1) % n for i in range(n)]),
    "cameras shuffled": _reorder(lambda n: np.random.default_rng(0).permutation(n).tolist()),
    "mirrored poses": lambda frames: _with_poses(frames, lambda _, p: _turn(p, MIRROR, MIRROR)),
    "OpenGL's axes": lambda frames: _with_poses(frames, lambda _, p: _turn(p, np.eye(3), OPENGL)),
    "focal length 30 % too long": _scale_focal(1.3),
    "focal length 30 % too short": _scale_focal(0.7),
    "one camera turned by 90 degrees": lambda frames: _with_poses(
        frames, lambda i, p: _turn(p, np.eye(3), QUARTER) if i == len(frames) // 2 else p
    ),
    "one camera far away": lambda frames: _with_poses(frames, lambda i, p: _far(p) if i == len(frames) // 2 else p),
}


def _far(pose: np.ndarray) -> np.ndarray:
    """Backwards by 100 times its distance from the origin."""
    behind = 100 * max(1.0, float(np.linalg.norm(pose[:, 3])))
    return np.concatenate([pose[:, :3], pose[:, 3:] - behind * pose[:, 2:3]], 1)


# Pictures, scrambled.


def _pictures(artifact: Artifact[Capture]) -> list[np.ndarray]:
    return [read_image(artifact.path(f.path)) for f in artifact.metadata.frames]


def scrambled_photos(
    pictures: list[np.ndarray], other: list[np.ndarray]
) -> Iterator[tuple[str, bool, list[np.ndarray]]]:
    """(what, whether it should pass, pictures) of captures without cameras."""
    height, width = pictures[0].shape[:2]
    fitted = [cv2.resize(p, (width, height), interpolation=cv2.INTER_AREA) for p in other]
    yield "the photos", True, pictures
    yield "half the photos of another scene", False, [*pictures[: len(fitted)], *fitted]
    yield "two photos", False, pictures[:2]
    yield "pure rotation", False, [_warped(pictures[0], _rotation(width, height, a)) for a in np.linspace(-12, 12, 9)]
    yield "the camera at rest, an object moving", False, [_pasted(pictures[0], i) for i in range(9)]
    yield "no texture", False, [cv2.GaussianBlur(p, (0, 0), width / 8) for p in pictures[:12]]
    yield "black frames", False, [np.zeros_like(p) if i % 2 else p for i, p in enumerate(pictures[:16])]


def _rotation(width: int, height: int, degrees: float) -> np.ndarray:
    k = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    turn, _ = cv2.Rodrigues(np.deg2rad([0.3 * degrees, degrees, 0]))
    return k @ turn @ np.linalg.inv(k)


def _warped(picture: np.ndarray, homography: np.ndarray) -> np.ndarray:
    height, width = picture.shape[:2]
    turned = cv2.warpPerspective(picture, homography, (width, height), borderMode=cv2.BORDER_REFLECT)
    y, x = height // 5, width // 5
    return np.ascontiguousarray(turned[y : height - y, x : width - x])


def _pasted(picture: np.ndarray, step: int) -> np.ndarray:
    height, width = picture.shape[:2]
    shown = picture.copy()
    h, w = height // 4, width // 4
    left = width // 10 + step * w // 4
    shown[height // 2 : height // 2 + h, left : left + w] = picture[:h, :w][:, ::-1]
    noise = np.random.default_rng(step).normal(0, 0.01, shown.shape)
    return np.clip(shown + noise, 0, 1).astype(np.float32)


# Running.


def take_in(store: FolderStore, folder: Path, name: str) -> Artifact[Capture]:
    """The folder as capture-ingest takes it, reduced to `SIDE` pixels, cameras with it."""
    place = store.private_folder()
    shutil.copytree(folder, place / "raw")
    source = store.put(place, "source", Source(name=name, kind="folder"))
    record = execute(f"{STAGES}capture_ingest", store, Invocation(inputs={"source": source}, threads=1), StringIO())
    whole = store.open(record.outputs["capture"], Capture)
    frames = list(whole.metadata.frames)
    factor = min(1.0, SIDE / max(frames[0].width, frames[0].height))
    pictures = [
        cv2.resize(p, (round(p.shape[1] * factor), round(p.shape[0] * factor)), interpolation=cv2.INTER_AREA)
        for p in _pictures(whole)
    ]
    cameras = [f.camera and f.camera.model_copy(update={"params": _scaled(f.camera.params, factor)}) for f in frames]
    return put(store, pictures, cameras, ordered=whole.metadata.ordered)


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


def judge(artifact: Artifact[Capture], database: Path | None, work: Path) -> tuple[str, bool, float]:
    """What pose-estimation says, whether it passes, CPU seconds; with a database, features and matches are there."""
    work.mkdir(parents=True)
    if database is not None:
        shutil.copyfile(database, work / "capture.db")
    logged: list[str] = []

    def emit(event: str, **values: object) -> None:
        if event == "log":
            logged.append(str(values["message"]))

    began = time.process_time()
    ctx = Context(seed=0, device="cpu", threads=1, work=work, emit=emit)
    try:
        solved = solve(artifact, Config(), ctx)
    except BadInputError as refusal:
        return " / ".join([*logged, str(refusal)]), False, time.process_time() - began
    r = solved.registration
    said = (
        f"{r.registered} of {r.given} views, {r.agreement:.1%} of matches agree, {r.mean_reprojection_error_px:.2f} px"
    )
    return " / ".join([*logged, said]), True, time.process_time() - began


def study_cameras(store: FolderStore, scene: str, artifact: Artifact[Capture], work: Path) -> Iterator[Row]:
    said, passed, shared = judge(artifact, None, work / "right")
    yield Row(scene, "the cameras as they are", True, "pose-estimation", said, round(shared, 1), passed)
    database = work / "right" / "capture.db"
    _, _, solving = judge(artifact, database, work / "again")
    for name, scramble in SCRAMBLED_CAMERAS.items():
        scrambled = with_frames(store, artifact, scramble(list(artifact.metadata.frames)))
        said, passed, own = judge(scrambled, database, work / name.replace("/", " "))
        yield Row(scene, name, False, "pose-estimation", said, round(shared - solving + own, 1), passed)


def study_photos(store: FolderStore, scene: str, artifact: Artifact[Capture], work: Path) -> Iterator[Row]:
    for name, good, pictures in scrambled_photos(_pictures(artifact), list(synthetic_scene(8, 320, 240).images)):
        taken = put(store, pictures, [None] * len(pictures), ordered=artifact.metadata.ordered)
        said, passed, cpu = judge(taken, None, work / f"photos {name}")
        yield Row(scene, f"{name}, without cameras", good, "pose-estimation", said, round(cpu, 1), passed)


def study_field(store: FolderStore, scene: str, artifact: Artifact[Capture]) -> Iterator[Row]:
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
    parser.add_argument("--study", action="append", choices=["cameras", "photos", "field"], help="default: cameras")
    given = parser.parse_args()
    silence_pycolmap()
    rows: list[Row] = json.loads(RESULTS.read_text())["rows"] if RESULTS.is_file() else []
    rows = [Row(**r) if isinstance(r, dict) else r for r in rows]
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        store = FolderStore(work / "store")
        folders = {n: Path(f) for n, f in (s.split("=", 1) for s in given.scene)} or {
            "demo": write_demo(work / "demo-capture")
        }
        for scene, folder in folders.items():
            artifact = take_in(store, folder, scene)
            chosen = given.study or ["cameras"]
            studies: list[Iterator[Row]] = []
            if "cameras" in chosen:
                studies.append(study_cameras(store, scene, artifact, work / scene))
            if "photos" in chosen:
                studies.append(study_photos(store, scene, artifact, work / scene))
            if "field" in chosen:
                studies.append(study_field(store, scene, artifact))
            for study in studies:
                for row in study:
                    rows = [r for r in rows if (r.scene, r.capture) != (row.scene, row.capture)] + [row]
                    print(row, flush=True)
                    write_rows(rows)
    wrong = [r for r in rows if r.passed != r.good]
    print(f"{len(rows)} captures, {len(wrong)} judged wrongly")


if __name__ == "__main__":
    main()
