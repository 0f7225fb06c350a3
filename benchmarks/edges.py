"""Whether straight edges that enter the hole go on in it where they should: on the demo capture, against the truth.

    python examples/demo/render.py --clean --out FOLDER                 # the truth: renderer/clean
    inpaint3d run examples/demo/capture --mask examples/demo/mask.yaml --name demo --want plate-export --compare
    python -m benchmarks.edges --run runs/demo --clean FOLDER/renderer/clean

Straight edges of the truth at a photo's own camera are found by OpenCV's LSD (von Gioi et al. 2010,
doi:10.1109/TPAMI.2008.300); those count that cross the border of the hole. Along the part inside, every few pixels, the
profile across the edge is compared with the truth's: the shift at which the two correlate best, and whether they do at
all. A line through the shifts says how far off, in pixels of the photo, and at what angle an edge goes on. The same
along the part outside, where plates are the photo itself, says what of it is the measure's own error. Writes
`benchmarks/results/edges.json`.
"""

import argparse
import json
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from benchmarks.plates import REPOSITORY, Run, find_box, render_enlarged
from benchmarks.provenance import commit
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Capture, CleanPlates, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.store import FolderStore
from inpaint3d.radiance.io import load_field
from inpaint3d.scene.image_io import Image, Mask, read_image, read_mask
from inpaint3d.stages.plate_export.lens import PhotoCamera

RESULTS = REPOSITORY / "benchmarks" / "results" / "edges.json"
FIELDS = {"render": "joint-optimization", "render without completion": "continued-reconstruction"}
MIN_INSIDE, MIN_OUTSIDE = 14, 8  # pixels of an edge on either side of the hole's border
STEP = 4  # pixels between profiles along an edge, each a mean over as many
SPAN, MOST_SHIFT = 5, 6  # pixels of a profile on either side of the edge, and how far it is looked for
ALIKE = 0.6  # correlation from which on an edge is there
MARGIN = 16  # pixels around the hole that are looked at


class Edge(NamedTuple):
    """A straight edge of the truth: points [n, 2] a pixel apart, the direction across it, which points are inside."""

    points: NDArray[np.float64]
    across: NDArray[np.float64]
    inside: Mask


class Found(NamedTuple):
    """A part of an edge in a picture: share of it that is there; offset, pixels, and angle, degrees, of that."""

    length: float
    share: float
    offset: float
    angle: float


def find_edges(truth: Image, hole: Mask) -> list[Edge]:
    """The straight edges of a picture that cross the border of a hole."""
    grey = (truth.mean(-1) * 255).clip(0, 255).astype(np.uint8)
    lines = cv2.createLineSegmentDetector().detect(grey)[0]
    edges = []
    for x0, y0, x1, y1 in [] if lines is None else np.asarray(lines, np.float64).reshape(-1, 4):
        along = np.array([x1 - x0, y1 - y0])
        length = float(np.hypot(*along))
        if length < MIN_INSIDE + MIN_OUTSIDE:
            continue
        points = np.array([x0, y0]) + np.arange(0, length, 1.0)[:, None] * along / length
        column, row = (points[:, i].round().astype(int).clip(0, hole.shape[1 - i] - 1) for i in (0, 1))
        inside = hole[row, column]
        if inside.sum() >= MIN_INSIDE and (~inside).sum() >= MIN_OUTSIDE:
            edges.append(Edge(points, np.array([-along[1], along[0]]) / length, inside))
    return edges


def follow_edge(edge: Edge, part: Mask, truth: Image, picture: Image) -> Found:
    """How the part of an edge that the truth shows goes on in a picture."""
    shifts = np.arange(-MOST_SHIFT, MOST_SHIFT + 0.25, 0.25)
    places, best = [], []
    chosen = np.flatnonzero(part)
    groups = [chosen[i : i + STEP] for i in range(0, len(chosen) - STEP + 1, STEP)]
    for group in groups:
        own = _sample_profile(truth, edge, group, 0.0)
        alike = [_correlate(own, _sample_profile(picture, edge, group, shift)) for shift in shifts]
        if max(alike) >= ALIKE:
            places.append(float(group.mean()))
            best.append(float(shifts[int(np.argmax(alike))]))
    share = len(places) / len(groups)
    if len(places) < 2:
        return Found(len(chosen), share, float("nan"), float("nan"))
    slope = np.polyfit(places, best, 1)[0]
    return Found(len(chosen), share, float(np.median(np.abs(best))), float(np.degrees(np.arctan(abs(slope)))))


def _sample_profile(picture: Image, edge: Edge, group: NDArray[np.int64], shift: float) -> NDArray[np.float64]:
    """Differences of colour across an edge [p, 3], mean over a few points along it."""
    steps = np.arange(-SPAN, SPAN + 0.5, 0.5) + shift
    xy = (edge.points[group][:, None] + steps[:, None] * edge.across).astype(np.float32)
    seen = cv2.remap(picture, xy[..., 0], xy[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.diff(seen.mean(0), axis=0).astype(np.float64)


def _correlate(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Of two profiles; a weaker edge is less alike, as what is soft there would hardly be seen."""
    return float((a * b).sum() / max((a * a).sum(), (b * b).sum(), 1e-12))


def measure_edges(run: Run, clean: Path) -> dict[str, Any]:
    """Edges in plates and renders, over all photos that have a truth."""
    capture = run.open("capture-ingest", "capture", Capture)
    posed = run.open("pose-estimation", "posed-capture", PosedCapture)
    plates = run.open("plate-export", "clean-plates", CleanPlates)
    fields = {}
    for name, node in FIELDS.items():
        if run.outputs.get(node):
            artifact = run.open(node, "radiance-field", RadianceFieldArtifact)
            fields[name] = load_field(artifact.path(artifact.metadata.weights), artifact.metadata.spec)
    frames, records = {f.name: f for f in capture.metadata.frames}, {p.name: p for p in plates.metadata.plates}
    found: dict[str, list[Found]] = {name: [] for name in ("plate, outside the hole", "plate", *fields)}
    for frame in (f for f in posed.metadata.frames if (clean / f"{f.name}.png").exists()):
        photo, truth = read_image(capture.path(frames[frame.name].path)), read_image(clean / f"{frame.name}.png")
        plate = read_image(plates.path(records[frame.name].picture))
        mask = read_mask(plates.path(records[frame.name].mask))
        camera = PhotoCamera.from_frame(frame, posed.metadata.lens, photo.shape[1], photo.shape[0])
        rows, columns = (slice(max(0, s.start - MARGIN), s.stop + MARGIN) for s in find_box(mask))
        box = (rows, columns)
        pictures = {"plate": plate[box]}
        pictures |= {n: render_enlarged(field, camera, box, photo, ~mask) for n, field in fields.items()}
        for edge in find_edges(truth[box], mask[box]):
            found["plate, outside the hole"].append(follow_edge(edge, ~edge.inside, truth[box], plate[box]))
            for name, picture in pictures.items():
                found[name].append(follow_edge(edge, edge.inside, truth[box], picture))
        print(frame.name, {name: len(parts) for name, parts in found.items()}, flush=True)
    return {name: summarise(parts) for name, parts in found.items()}


def summarise(parts: list[Found]) -> dict[str, float | None]:
    """How many edges; share of their length that is there; median offset and angle of what is, None without any."""
    length = np.array([p.length for p in parts])
    there = [p for p in parts if np.isfinite(p.offset)]
    return {
        "edges": len(parts),
        "share_of_length": round(float((length * [p.share for p in parts]).sum() / length.sum()), 4),
        "offset_px": round(float(np.median([p.offset for p in there])), 3) if there else None,
        "angle_deg": round(float(np.median([p.angle for p in there])), 3) if there else None,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--clean", type=Path, required=True, help="folder of the truth at the photos' cameras")
    parser.add_argument("--store", type=Path, default=Path(".inpaint3d/store"))
    options = parser.parse_args()
    measured = measure_edges(Run(options.run, FolderStore(options.store)), options.clean)
    RESULTS.write_text(json.dumps({"code": commit(), "demo": measured}, indent=1) + "\n")
    print(json.dumps(measured, indent=1))


if __name__ == "__main__":
    main()
