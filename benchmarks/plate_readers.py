"""Clean plates as other tools read them: `python -m benchmarks.plate_readers PLATES`, a folder of plate-export.

pycolmap reads `sparse/`, nerfstudio's parser `transforms.json`, in the environment of `make bench-radiance`. Compared
are poses, sizes and where the cameras see a grid of rays; and each plate must be found. Adds to
`benchmarks/results/plates.json`.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from benchmarks.plates import RESULTS
from benchmarks.provenance import REPOSITORY, commit
from numpy.typing import NDArray

PEER = REPOSITORY / ".cache" / "radiance-peer" / "bin" / "python"
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])
"""Of a camera's axes: nerfstudio's look along -z."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plates", type=Path)
    folder = parser.parse_args().plates
    if not PEER.is_file():
        sys.exit(f"{PEER} is not there; make {PEER.parents[1].relative_to(REPOSITORY)}/.installed")
    by_colmap, by_nerfstudio = read_colmap(folder), read_nerfstudio(folder)
    if by_colmap.keys() != by_nerfstudio.keys():
        sys.exit(f"pycolmap finds {sorted(by_colmap)}, nerfstudio {sorted(by_nerfstudio)}")
    differences = [compare(by_colmap[name], by_nerfstudio[name]) for name in by_colmap]
    found = {
        "plates": len(by_colmap),
        "pictures_found": sum(camera["found"] for camera in by_nerfstudio.values()),
        **{f"largest_difference_of_{key}": max(d[key] for d in differences) for key in differences[0]},
    }
    results = json.loads(RESULTS.read_text())
    results["readers"] = {**commit(), **found}
    RESULTS.write_text(json.dumps(results, indent=1) + "\n")
    print(json.dumps(found, indent=1))


def read_colmap(folder: Path) -> dict[str, dict[str, Any]]:
    """Pose, size and picture points of each plate's camera by the file's name."""
    model = pycolmap.Reconstruction(str(next(folder.glob("sparse/*/cameras.*")).parent))
    cameras: dict[str, dict[str, Any]] = {}
    for image in model.images.values():
        camera, pose = model.cameras[image.camera_id], image.cam_from_world().inverse().matrix()
        rays = spread_rays(camera.width / camera.focal_length_x, camera.height / camera.focal_length_y)
        cameras[Path(image.name).name] = {
            "pose": np.column_stack([pose[:, :3] @ OPENGL_FROM_OPENCV, pose[:, 3]]),
            "size": np.array([camera.width, camera.height]),
            "points": np.array(camera.img_from_cam(rays)),
            "rays": rays,
        }
    return cameras


def spread_rays(width: float, height: float) -> NDArray[np.float64]:
    """A grid over the frame, [n, 3] with z = 1; sizes in focal lengths."""
    x, y = np.meshgrid(np.linspace(-0.45, 0.45, 9) * width, np.linspace(-0.45, 0.45, 9) * height)
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)


def read_nerfstudio(folder: Path) -> dict[str, dict[str, Any]]:
    """What nerfstudio reads: `benchmarks/radiance/peer/cameras.py`."""
    script = REPOSITORY / "benchmarks" / "radiance" / "peer" / "cameras.py"
    told = subprocess.run(
        [str(PEER), "-W", "ignore", str(script), str(folder)], check=True, capture_output=True, text=True
    )
    return {camera["name"]: camera for camera in json.loads(told.stdout.splitlines()[-1])}


def compare(colmap: dict[str, Any], nerfstudio: dict[str, Any]) -> dict[str, float]:
    """Largest differences: of poses in world units, of sizes and picture points in pixels."""
    fx, fy, cx, cy = nerfstudio["focal_centre"]
    k1, k2, k3, k4, p1, p2 = nerfstudio["distortion"]  # nerfstudio's k4 is OpenCV's of the denominator
    lens = np.array([k1, k2, p1, p2, k3, k4, 0.0, 0.0])
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    points = cv2.projectPoints(colmap["rays"], np.zeros(3), np.zeros(3), matrix, lens)[0][:, 0]
    pairs = {
        "pose": (colmap["pose"], nerfstudio["world_from_cam"]),
        "size": (colmap["size"], nerfstudio["size"]),
        "points": (colmap["points"], points),
    }
    return {key: float(f"{np.abs(np.asarray(a) - np.asarray(b)).max():.3g}") for key, (a, b) in pairs.items()}


if __name__ == "__main__":
    main()
