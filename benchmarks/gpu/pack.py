"""What `benchmarks.gpu` needs on a machine without a network, in one folder: `make pack-gpu PHOTOS="FOLDER ..."`.

    python -m benchmarks.gpu.pack FOLDER ... [--prior DIR] [--scene DIR] [--out gpu-pack] [--limit-mib 60]

Sources, wheels (CPython 3.12, x86-64 Linux) of what such a machine may lack, and a corpus of the folders' pictures, as
many as fit, made smaller: a folder in a FOLDER is a scene, a picture at its top one of its own, and which are held out
their names say, as in `diffusion_training.corpus`. --prior: a diffusion-prior artifact to go on from. --scene: a folder
that `benchmarks.radiance.scene.run_until` filled. There: python3 gpu-pack/start.py --out FOLDER --minutes 9
"""

import argparse
import json
import random
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from benchmarks.provenance import REPOSITORY, commit

from inpaint3d.contracts.models.artifacts import EffectPlan, PosedCapture
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES
from inpaint3d.contracts.store import FolderStore
from inpaint3d.scene.image_io import read_image
from inpaint3d.stages.diffusion_training.corpus import write_corpus

SOURCES = (
    "lib/*/src", "lib/radiance/tests/triton_run.py", "stages/*/src", "stages/*/stage.yaml", "orchestrator/src",
    "benchmarks/*.py", "benchmarks/gpu", "pipeline.yaml", "schemas/parameters",
)  # fmt: skip
WHEELS = (
    "annotated-types", "jaxtyping", "openimageio", "pydantic", "pydantic-core", "pyyaml", "safetensors",
    "typing-extensions", "typing-inspection", "wadler-lindig",
)  # fmt: skip
PLATFORMS = ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64")
PIP = REPOSITORY / ".cache" / "uv-home" / "bin" / "pip"
MIB = 2**20
SPARE_MIB = 0.5
QUALITY = 86
"""Of the JPEGs."""


def main() -> None:
    options = arguments()
    shutil.rmtree(options.out, ignore_errors=True)
    options.out.mkdir(parents=True)
    copy_sources(options.out / "source")
    if options.wheels:
        fetch_wheels(options.out / "wheels")
    if options.prior:
        shutil.copytree(options.prior, options.out / "prior")
    if options.scene:
        copy_scene(options.scene, options.out / "scene")
    shutil.copyfile(Path(__file__).with_name("start.py"), options.out / "start.py")
    room = min(options.corpus_mb * 1e6, (options.limit_mib - SPARE_MIB) * MIB - size_of(options.out))
    if room <= 0:
        sys.exit(f"{options.out} holds {size_of(options.out) / MIB:.1f} MiB before any picture; raise --limit-mib")
    pictures = pack_corpus(options.folders, options.out / "corpus", room, options.short_side, options.held_out)
    (options.out / "packed.json").write_text(json.dumps({**commit(), "pictures": pictures}, indent=1) + "\n")
    print(f"{options.out}: {pictures} pictures, {size_of(options.out) / MIB:.1f} MiB")
    print(f"there: python3 {options.out.name}/start.py --out FOLDER --minutes 9")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "gpu-pack")
    parser.add_argument("--prior", type=Path)
    parser.add_argument("--scene", type=Path)
    parser.add_argument("--limit-mib", type=float, default=60.0, help="of all together")
    parser.add_argument("--corpus-mb", type=float, default=45.0, help="of the pictures, at most")
    parser.add_argument("--short-side", type=int, default=176, help="of the pictures, pixels; smaller ones stay")
    parser.add_argument(
        "--held-out", type=float, default=0.0753, help="share of scenes for judging, as priors/README.md"
    )
    parser.add_argument("--no-wheels", dest="wheels", action="store_false", help="the machine has the packages")
    return parser.parse_args()


def size_of(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def copy_sources(out: Path) -> None:
    """What git knows of, as it lies here."""
    patterns = [f":(glob){pattern}" for source in SOURCES for pattern in (source, f"{source}/**")]
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns],
        cwd=REPOSITORY, check=True, capture_output=True, text=True,
    )  # fmt: skip
    for name in listed.stdout.splitlines():
        if (REPOSITORY / name).is_file():
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(REPOSITORY / name, out / name)


def fetch_wheels(out: Path) -> None:
    """The locked versions, for the machine that the pack is for."""
    locked = tomllib.loads((REPOSITORY / "uv.lock").read_text())["package"]
    wanted = [f"{package['name']}=={package['version']}" for package in locked if package["name"] in WHEELS]
    platforms = [word for platform in PLATFORMS for word in ("--platform", platform)]
    fixed = ["--no-deps", "--only-binary=:all:", "--python-version", "3.12", "--implementation", "cp", *platforms]
    subprocess.run([str(PIP), "download", "--quiet", *fixed, "--dest", str(out), *wanted], check=True)


def copy_scene(folder: Path, out: Path) -> None:
    """The posed capture and the plan of a run in a folder."""
    from benchmarks.radiance import scene as scenes

    found, store = (
        {node: stage["outputs"] for node, stage in scenes.stages(folder).items()},
        FolderStore(folder / "store"),
    )
    posed = store.open(found["pose-estimation"]["posed-capture"], PosedCapture)
    plan = store.open(found["scene-analysis"]["effect-plan"], EffectPlan)
    shutil.copytree(posed.root, out / "posed-capture")
    shutil.copytree(plan.root, out / "effect-plan")


def pack_corpus(folders: Sequence[Path], out: Path, room: float, short_side: int, held_out: float) -> int:
    """A corpus of at most `room` bytes of the folders' pictures, drawn at random but always alike; how many."""
    with tempfile.TemporaryDirectory() as work:
        staged, used = Path(work), 0.0
        for path, name in _shuffled(folders):
            data = shrink(path, short_side)
            # Its line in the manifest counts too.
            used += len(data) + 400
            if used > room:
                break
            target = staged / name
            if target.exists():
                sys.exit(f"two pictures are called {name}; rename one of {path}")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
        return len(write_corpus(staged, out, held_out=held_out))


def _shuffled(folders: Sequence[Path]) -> Iterator[tuple[Path, Path]]:
    """Pictures with their names in the corpus."""
    found = [
        (path, path.relative_to(folder).with_suffix(".jpg"))
        for folder in folders
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix.lower() in PICTURE_SUFFIXES
    ]
    if not found:
        sys.exit(f"no pictures in {', '.join(map(str, folders))}")
    random.Random(0).shuffle(found)
    yield from found


def shrink(path: Path, short_side: int) -> bytes:
    """A picture as a JPEG of at most so short a side."""
    picture = read_image(path)
    height, width = picture.shape[:2]
    scale = min(1.0, short_side / min(height, width))
    size = (round(width * scale), round(height * scale))
    smaller = cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if scale < 1 else picture
    codes = np.round(smaller * 255).clip(0, 255).astype(np.uint8)
    done, data = cv2.imencode(".jpg", cv2.cvtColor(codes, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not done:
        sys.exit(f"{path} could not be written as JPEG")
    return data.tobytes()


if __name__ == "__main__":
    main()
