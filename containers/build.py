"""Build the images of the stages and write `images.yaml`, which names each with its digest.

    python containers/build.py [--only NAME ...] [--base IMAGE] [--registry PREFIX] [--source URL]
                               [--variant cpu|cuda] [-- BUILDER OPTIONS]

`buildah` does the work; what follows `--` is handed to it. Images are called PREFIX/inpaint3d/NAME:REVISION. The stages
with torch stand on one image, built before them where there is none of the same lock. All stages are built from one
Containerfile; its arguments are told from the lock.
"""

import argparse
import json
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import yaml
from packaging.markers import Marker

from inpaint3d.contracts.models.canonical import digest_of, file_digest
from inpaint3d.contracts.models.cluster import ImagesSpec
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.stage import load_stage

HERE = Path(__file__).parent
ROOT = HERE.parent
TORCH, ORCHESTRATOR, KERNELS = "torch", "orchestrator", "inpaint3d-kernels"
BUILDS = "image-builds.json"
IMAGE_MACHINE = {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix",
                 "python_full_version": "3.12.1", "python_version": "3.12", "platform_machine": "x86_64",
                 "implementation_name": "cpython"}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", choices=stages(), help="may be repeated; default: all")
    parser.add_argument("--base", default="docker.io/library/python:3.12-slim")
    parser.add_argument("--registry", default="localhost")
    parser.add_argument("--source", help="where the code is published")
    parser.add_argument("--variant", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--images", type=Path, default=ROOT / ".cache" / "images.yaml")
    parser.add_argument("options", nargs="*", help="for buildah")
    given = parser.parse_args()
    revision = _said("git", "rev-parse", "--short=12", "HEAD")
    built = load_document(given.images, ImagesSpec)[0].model_dump()["spec"] if given.images.is_file() else {}
    given.images.parent.mkdir(parents=True, exist_ok=True)
    wanted = given.only or stages()
    torch = f"{given.registry}/inpaint3d/{TORCH}:{torch_version(given)}"
    for name in [*([TORCH] if any(map(on_torch, wanted)) else []), *wanted]:
        tag = f"{given.registry}/inpaint3d/{name}:{revision}" if name != TORCH else torch
        base = torch if on_torch(name) else given.base
        if name == TORCH and _exists(torch):
            continue
        began = time.monotonic()
        build(name, tag, base, revision, given)
        digest = _digest(tag)
        sys.stdout.write(f"{tag} {digest}\n")
        _remember(given.images.with_name(BUILDS), name, tag, base, round(time.monotonic() - began, 1))
        if name != TORCH:
            built[f"inpaint3d/{name}"] = {"image": tag, "digest": digest}
            document = {"apiVersion": "inpaint3d/v1", "kind": "Images", "spec": built}
            given.images.write_text(yaml.safe_dump(document, sort_keys=False))


def stages() -> list[str]:
    """Every image that somebody runs: those of the stages, by their folders, and the orchestrator's."""
    folders = (path.parent.name for path in ROOT.glob("stages/*/stage.yaml"))
    return sorted([*(name.replace("_", "-") for name in folders), ORCHESTRATOR])


def containerfile(name: str) -> str:
    """The file that an image is built from, in this folder."""
    return f"{name if name in (TORCH, ORCHESTRATOR) else 'stage'}.Containerfile"


def distributions(package: str) -> set[str]:
    """Every distribution that `uv sync --package PACKAGE` installs in an image, told from the lock."""
    locked = {p["name"]: p for p in tomllib.loads((ROOT / "uv.lock").read_text())["package"]}
    waiting: list[tuple[str, str | None]] = [(package, None)]
    found: set[tuple[str, str | None]] = set()
    while waiting:
        if (item := waiting.pop()) in found:
            continue
        found.add(item)
        name, extra = item
        entry = locked[name]
        needs = entry.get("dependencies", []) if extra is None else entry["optional-dependencies"].get(extra, [])
        for need in needs:
            if "marker" not in need or Marker(need["marker"]).evaluate(IMAGE_MACHINE):
                waiting += [(need["name"], e) for e in (None, *need.get("extra", ()))]
    return {name for name, _ in found}


def on_torch(name: str) -> bool:
    """Whether an image stands on the one with torch: its package needs torch."""
    return TORCH in distributions(f"inpaint3d-{name}")


def arguments_of(name: str, base: str, variant: str) -> dict[str, str]:
    """The build arguments of an image."""
    if name == TORCH:
        return {"BASE": base, "VARIANT": variant}
    if name == ORCHESTRATOR:
        return {"BASE": base}
    kernels = "yes" if KERNELS in distributions(f"inpaint3d-{name}") else "no"
    return {"STAGE": name, "BASE": base, "KERNELS": kernels}


def torch_version(given: argparse.Namespace) -> str:
    """A name for all that the image with torch is made from: looking for gigabytes in a cache takes minutes."""
    lock = (ROOT / "uv.lock").read_text()
    parts = [_digest(given.base), given.variant, file_digest(HERE / f"{TORCH}.Containerfile"), others_packages(lock)]
    return digest_of(parts).removeprefix("sha256:")[:12]


def others_packages(lock: str) -> str:
    """The digest of what a lock says of others' packages; which of ours needs which does not touch torch's layer."""
    return digest_of([p for p in tomllib.loads(lock)["package"] if "registry" in p["source"]])


def build(name: str, tag: str, base: str, revision: str, given: argparse.Namespace) -> None:
    labels = {
        "org.opencontainers.image.title": f"inpaint3d/{name}",
        # The one with torch is the same for every revision of the same lock, and so are the layers on it.
        **({"org.opencontainers.image.revision": revision} if name != TORCH else {}),
        "org.opencontainers.image.licenses": "Apache-2.0",
        "org.opencontainers.image.base.name": base,
        "org.opencontainers.image.base.digest": _digest(base),
        **({"org.opencontainers.image.source": given.source} if given.source else {}),
        **contract_labels(name),
    }
    arguments = arguments_of(name, base, given.variant)
    line = ["buildah", "build", "--layers"]
    line += [part for key, value in arguments.items() for part in ("--build-arg", f"{key}={value}")]
    line += [part for key, value in labels.items() for part in ("--label", f"{key}={value}")]
    line += [*given.options, "--tag", tag, "--file", f"containers/{containerfile(name)}", "."]
    subprocess.run(line, cwd=ROOT, check=True)


def contract_labels(name: str) -> dict[str, str]:
    """Version and contract ids of a stage's image; the orchestrator has none."""
    file = ROOT / "stages" / name.replace("-", "_") / "stage.yaml"
    if not file.is_file():
        return {}
    stage = load_stage(file)
    return {
        "org.opencontainers.image.version": stage.metadata.version,
        "inpaint3d.inputs": json.dumps({p: d.schema_range for p, d in stage.spec.inputs.items()}),
        "inpaint3d.outputs": json.dumps({p: d.schema_id for p, d in stage.spec.outputs.items()}),
    }


def _remember(file: Path, name: str, tag: str, base: str, seconds: float) -> None:
    """What `measure.py` makes its table of."""
    builds = json.loads(file.read_text()) if file.is_file() else {}
    builds[name] = {"image": tag, "base": base, "seconds": seconds}
    file.write_text(json.dumps(builds, indent=2) + "\n")


def _exists(image: str) -> bool:
    return subprocess.run(["buildah", "inspect", "--type", "image", image], capture_output=True).returncode == 0


def _digest(image: str) -> str:
    return _said("buildah", "inspect", "--type", "image", "--format", "{{.FromImageDigest}}", image)


def _said(*line: str) -> str:
    return subprocess.run(line, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    main()
