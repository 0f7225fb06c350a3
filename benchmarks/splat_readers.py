"""Splats as other programs read them: `python -m benchmarks.splat_readers SPLATS`, a folder of splat-export.

gsply (PyPI) and PlayCanvas' splat-transform (npm) read the PLY and the SPZ; trimesh (PyPI) and Khronos' glTF validator
(npm) the GLB. They are installed in `.cache/splat-readers` when first asked. Compared is what they read with the layer
in USD, as OpenUSD reads it: largest differences. Adds to `benchmarks/results/splats.json`.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from benchmarks.provenance import REPOSITORY, commit
from benchmarks.splats import RESULTS, Arrays, read_usd
from numpy.typing import NDArray

HOME = REPOSITORY / ".cache" / "splat-readers"
PYTHON = ["gsply==0.4.6", "trimesh==5.2.0"]
NODE = ["@playcanvas/splat-transform@2.7.1", "gltf-validator@2.0.0-dev.3.10"]

GSPLY = """
import sys, gsply, numpy as np
read = gsply.read_spz if sys.argv[1].endswith("spz") else gsply.plyread
d = read(sys.argv[1])
np.savez(sys.argv[2], mean=d.means, log_scale=d.scales, rotation=d.quats, opacity=d.opacities, coefficients=d.sh0)
"""
TRIMESH = """
import sys, trimesh, numpy as np
(points,) = trimesh.load_scene(sys.argv[1]).geometry.values()
np.savez(sys.argv[2], mean=points.vertices)
"""
VALIDATOR = """
const validator = require("gltf-validator"), fs = require("fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then(
  (report) => console.log(JSON.stringify(report.issues)));
"""


def prepare() -> None:
    """Install the readers where they are not."""
    if not (HOME / "node_modules").is_dir():
        subprocess.run([sys.executable, "-m", "venv", str(HOME)], check=True)
        subprocess.run([str(HOME / "bin" / "pip"), "install", "--quiet", *PYTHON], check=True)
        subprocess.run(["npm", "install", "--silent", "--prefix", str(HOME), *NODE], check=True)


def read_by_python(script: str, path: Path, folder: Path) -> Arrays:
    out = folder / "read.npz"
    subprocess.run([str(HOME / "bin" / "python"), "-c", script, str(path), str(out)], check=True)
    return {name: array.astype(np.float64) for name, array in np.load(out).items()}


def read_by_splat_transform(path: Path, folder: Path) -> Arrays:
    """What it writes again as CSV."""
    out = folder / "read.csv"
    tool = str(HOME / "node_modules" / ".bin" / "splat-transform")
    subprocess.run([tool, "--quiet", "--overwrite", str(path), str(out)], check=True)
    rows = np.genfromtxt(out, delimiter=",", names=True)
    columns = {
        "mean": "x y z", "log_scale": "scale_0 scale_1 scale_2", "opacity": "opacity",
        "coefficients": "f_dc_0 f_dc_1 f_dc_2", "rotation": "rot_0 rot_1 rot_2 rot_3",
    }  # fmt: skip
    return {name: np.stack([rows[column] for column in names.split()], 1) for name, names in columns.items()}


def compare(read: Arrays, truth: Arrays) -> dict[str, float]:
    """Largest differences; of rotations and places by what is the same in any axes: the angle to the first splat's
    rotation, the distance from the first splat.
    """
    found = dict(read)
    if "opacity" in found:
        found["alpha"] = 1 / (1 + np.exp(-found.pop("opacity").reshape(-1)))
    differences = {}
    for name, array in found.items():
        ours, theirs = (_free_of_axes(name, each) for each in (truth[name], array))
        differences[name] = float(f"{np.abs(ours - theirs).max():.3g}")
    return differences


def _free_of_axes(name: str, array: NDArray[np.float64]) -> NDArray[np.float64]:
    if name == "mean":
        return np.linalg.norm(array - array[0], axis=1)
    if name == "rotation":
        unit = array / np.linalg.norm(array, axis=1, keepdims=True)
        return np.abs(unit @ unit[0])
    return array


def measure_covariances(read: Arrays) -> NDArray[np.float64]:
    """[n, 3, 3]: what of scales and rotations can be seen; several rotations may say the same."""
    w, x, y, z = (read["rotation"] / np.linalg.norm(read["rotation"], axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    root = np.moveaxis(np.array(rows), -1, 0) * np.exp(read["log_scale"])[:, None]
    return root @ root.swapaxes(1, 2)


def compare_axes(read: Arrays, other: Arrays) -> dict[str, float]:
    """Largest differences of places, scene units, and of covariances, in the splat's largest variance."""
    ours, theirs = measure_covariances(read), measure_covariances(other)
    size = np.exp(2 * read["log_scale"]).max(1)[:, None, None]
    found = {"mean": np.abs(read["mean"] - other["mean"]).max(), "covariance": (np.abs(ours - theirs) / size).max()}
    return {name: float(f"{value:.3g}") for name, value in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("splats", type=Path)
    folder = parser.parse_args().splats
    prepare()
    truth = read_usd(folder / "splats.usdc")
    found: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as room:
        again: list[Arrays] = []
        for one in ("ply", "spz"):
            file = folder / f"splats.{one}"
            found[f"{one}, gsply"] = compare(read_by_python(GSPLY, file, Path(room)), truth)
            again.append(read_by_splat_transform(file, Path(room)))
            found[f"{one}, splat-transform"] = compare(again[-1], truth)
        found["spz in the ply's axes, splat-transform"] = compare_axes(*again)
        found["glb, trimesh"] = compare(read_by_python(TRIMESH, folder / "splats.glb", Path(room)), truth)
    told = subprocess.run(
        ["node", "-e", VALIDATOR, str(folder / "splats.glb")],
        cwd=HOME, check=True, capture_output=True, text=True,
    )  # fmt: skip
    issues = json.loads(told.stdout)
    found["glb, validator"] = {key: issues[key] for key in ("numErrors", "numWarnings", "numInfos")}
    found["glb, validator says"] = sorted({message["message"] for message in issues["messages"]})
    results = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    RESULTS.write_text(json.dumps(results | {"readers": commit() | found}, indent=1) + "\n")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
