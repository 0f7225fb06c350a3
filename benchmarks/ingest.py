"""Large photos taken in and ingested: CPU seconds and peak memory.

python -m benchmarks.ingest [--photos 200] [--megapixels 12] [--work FOLDER]

The photos are of noise that JPEG can make little of, so that decoding costs what it does for sharp ones; they differ by
a comment, and every tenth is to be turned (EXIF), so that it is written anew. Four times their size is needed on the
disk, and given back. Figures go to benchmarks/results/ingest.json.
"""

import argparse
import json
import os
import tempfile
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
from benchmarks.provenance import REPOSITORY, commit

from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.kit.shim import execute
from inpaint3d.contracts.models.artifacts import Capture
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.intake import take_capture

# EXIF with nothing but orientation 6: a TIFF of one entry.
TURN = b"\xff\xe1\x00\x22Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
RESULTS = REPOSITORY / "benchmarks" / "results" / "ingest.json"


def write_photos(folder: Path, count: int, megapixels: float) -> int:
    """Photos of 4:3; how many bytes they have together."""
    folder.mkdir()
    height = round((megapixels * 1e6 * 3 / 4) ** 0.5)
    noise = np.random.default_rng(0).normal(128, 40, (height // 4, height // 3, 3)).clip(0, 255).astype(np.uint8)
    picture = cv2.resize(noise, (height * 4 // 3, height), interpolation=cv2.INTER_CUBIC)
    data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()
    for i in range(count):
        note = b"\xff\xfe\x00\x06" + f"{i:04d}".encode()
        turn = TURN if i % 10 == 0 else b""
        (folder / f"IMG_{i:04d}.jpg").write_bytes(data[:2] + turn + note + data[2:])
    return count * len(data)


def ingest(folder: Path, place: Path) -> int:
    """Take a folder in as `inpaint3d run` does, and ingest it on one thread; how many frames it has."""
    store = FolderStore(place)
    given = Invocation(inputs={"source": take_capture(store, folder)}, threads=1)
    made = execute("inpaint3d.stages.capture_ingest", store, given, StringIO())
    return len(store.open(made.outputs["capture"], Capture).metadata.frames)


def measure(folder: Path, place: Path, expected: int) -> tuple[float, float]:
    """CPU seconds and peak MiB of a process that does nothing else."""
    child = os.fork()
    if child == 0:
        os._exit(0 if ingest(folder, place) == expected else 1)
    _, status, usage = os.wait4(child, 0)
    if status != 0:
        raise RuntimeError(f"{folder} was not ingested (status {status})")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**10


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=int, default=200)
    parser.add_argument("--megapixels", type=float, default=12.0)
    parser.add_argument("--work", type=Path, help="where there is room; default: the system's folder for what passes")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=given.work) as work:
        size = write_photos(Path(work) / "photos", given.photos, given.megapixels)
        cpu_s, peak_mib = measure(Path(work) / "photos", Path(work) / "store", given.photos)
    figures = {
        "photos": given.photos, "megapixels": given.megapixels, "MiB": round(size / 2**20),
        "cpu_s": round(cpu_s, 1), "peak_mib": round(peak_mib),
    }  # fmt: skip
    RESULTS.write_text(json.dumps(commit() | figures, indent=1) + "\n")
    print(figures)


if __name__ == "__main__":
    main()
