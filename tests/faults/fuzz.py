"""Damaged documents and files, thousands of each: read, or refused with one of our errors; nothing else happens.

    python -m tests.faults.fuzz --count 100000 [--seed 0]

Each input is a good one with a few bytes, lines or tokens changed, or bytes of no meaning. Captures with their pictures
and cameras have a fuzzer of their own (`tests/fuzz_captures.py`), which watches what is opened, too.
"""

import argparse
import collections
import contextlib
import json
import os
import random
import struct
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save_file

from inpaint3d.contracts.errors import Inpaint3dError
from inpaint3d.contracts.kit.checkpoints import OPEN_SEAL, find_checkpoint, write_checkpoint
from inpaint3d.contracts.kit.invocation import Invocation, load_invocation
from inpaint3d.contracts.models.artifacts.masks import MaskRequest
from inpaint3d.contracts.models.cluster import ClusterSpec
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.onnx_signature import read_onnx_signature
from inpaint3d.contracts.models.pipeline import PipelineSpec
from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.models.untrusted import UntrustedError, parse_json, parse_yaml, read_safetensors_header
from inpaint3d.contracts.store import Record
from inpaint3d.contracts.store.artifact import parse_manifest
from inpaint3d.orchestrator.diffusers_pipeline import INDEX, read_kind
from inpaint3d.scene.capture_io import load_points
from inpaint3d.scene.icc import read_profile
from inpaint3d.scene.image_io import read_image, read_mask, write_png
from inpaint3d.scene.map_io import write_exr
from tests.colour_profiles import DISPLAY_P3, SRGB_CURVE, matrix_profile
from tests.conftest import REPOSITORY
from tests.faults.results import conclude
from tests.faults.trials import build_store
from tests.sam_networks import write_networks

TOKENS = [
    b"null", b"true", b"-1", b"0", b"1e999", b"nan", b".inf", b"9" * 400, b"''", b"../..", b"/etc/passwd", b"sha256:",
    b"[", b"]", b"{", b"}", b"&a", b"*a", b"<<: *a", b"!!int x", b"!!binary x", b"? ", b"- ", b"2026-13-45", b"[" * 200,
    b"- " * 200, b"\n", b"\t", b"\x00", b"\xff", b"\xf0\x9f\x98\x80", b"\xed\xa0\x80", b"\\u0000", b'"', b"'", b"|",
]  # fmt: skip
Read = Callable[[Path], object]


def mutate(data: bytes, rng: random.Random) -> bytes:
    """A few changes of a good input; now and then bytes of no meaning at all."""
    if rng.random() < 0.02:
        return rng.randbytes(rng.randrange(200))
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 1, 2, 4, 16])):
        at, size = rng.randrange(len(changed) + 1), rng.choice([1, 1, 2, 8, 64])
        how = rng.randrange(6)
        if how == 0 and at < len(changed):
            changed[at] ^= 1 << rng.randrange(8)
        elif how == 1:
            changed[at : at + size] = rng.randbytes(size)
        elif how == 2:
            del changed[at : at + size]
        elif how == 3:
            changed[at:at] = rng.choice(TOKENS)
        elif how == 4:
            end = bytes(changed).find(b"\n", at) if rng.random() < 0.5 else at + size
            changed[at : max(end, at)] = rng.choice(TOKENS)
        else:
            other = rng.randrange(len(changed) + 1)
            changed[at:at] = changed[other : other + size]
    return bytes(changed[: rng.randrange(len(changed) + 1)]) if rng.random() < 0.05 else bytes(changed)


def make_targets(folder: Path) -> dict[str, tuple[bytes, str, Read]]:
    """Target -> a good input, the file's name, and what reads it."""
    store = folder / "store"
    store.mkdir()
    build_store(store)
    (key, *_) = sorted((store / "keys").iterdir())
    (record,) = (store / "runs" / "a").iterdir()
    (manifest, *_) = sorted((store / "objects").glob("*/artifact.json"))
    rng = np.random.default_rng(0)
    picture = rng.random((12, 16, 3), np.float32)
    write_png(folder / "a.png", picture)
    write_png(folder / "mask.png", picture[..., 0] > 0.5)
    write_exr(folder / "a.exr", {"R": picture[..., 0], "G": picture[..., 1], "B": picture[..., 2]})
    points = {
        "xyz": np.zeros((2, 3), np.float32), "rgb": np.zeros((2, 3), np.uint8), "error": np.zeros(2, np.float32),
        "track_offsets": np.zeros(3, np.int64), "track_frame": np.zeros(2, np.int32),
        "track_xy": np.zeros((2, 2), np.float32),
    }  # fmt: skip
    save_file(points, folder / "points.safetensors")
    header = json.dumps({"__metadata__": OPEN_SEAL}).encode()
    body = struct.pack("<Q", len(header)) + header + bytes(64)
    write_checkpoint(folder / "checkpoint.safetensors", lambda staged: staged.write_bytes(body))
    pipeline = (REPOSITORY / "pipeline.yaml").read_bytes()
    stage = (REPOSITORY / "stages" / "evaluation" / "stage.yaml").read_bytes()
    cluster = b"apiVersion: inpaint3d/v1\nkind: Cluster\nmetadata: {name: a}\nspec: {store: 's3://a/b', cache: {}}\n"
    mask = b"mask:\n  kind: sphere\n  centre: [0, 0, 0.5]\n  radius: 0.3\n"
    invocation = Invocation(inputs={"a": "sha256:" + "0" * 64}, parameters={"steps": 3}).model_dump_json().encode()
    onnx = write_networks(folder / "networks", "sam")[1].read_bytes()
    index = b'{"_class_name": "StableDiffusionInpaintPipeline", "unet": ["diffusers", "UNet2DConditionModel"]}'
    return {
        "YAML": (pipeline[:3000], "a.yaml", lambda p: parse_yaml(p.read_text(errors="replace"))),
        "JSON": (record.read_bytes(), "a.json", lambda p: parse_json(p.read_bytes())),
        "pipeline.yaml": (pipeline, "pipeline.yaml", lambda p: load_document(p, PipelineSpec)),
        "stage.yaml": (stage, "stage.yaml", load_stage),
        "cluster.yaml": (cluster, "cluster.yaml", lambda p: load_document(p, ClusterSpec)),
        "mask request": (mask, "request.yaml", lambda p: load_document(p, MaskRequest)),
        "invocation": (invocation, "a.json", load_invocation),
        "key record": (key.read_bytes(), "a.json", lambda p: Record.decode(p.read_bytes(), f"sha256:{key.stem}")),
        "run record": (record.read_bytes(), "a.json", _read_run),
        "manifest": (manifest.read_bytes(), "a.json", lambda p: parse_manifest(p.read_bytes(), str(p))),
        "diffusers index": (index, INDEX, lambda p: read_kind(p.parent)),
        "ONNX": (onnx, "a.onnx", read_onnx_signature),
        "safetensors header": (
            (folder / "points.safetensors").read_bytes(), "a.safetensors", read_safetensors_header,
        ),
        "sparse points": ((folder / "points.safetensors").read_bytes(), "points.safetensors", _read_points),
        "checkpoint": (
            (folder / "checkpoint.safetensors").read_bytes(), "c.safetensors", _read_checkpoint,
        ),
        "colour profile": (matrix_profile(DISPLAY_P3, SRGB_CURVE), "a.icc", _read_profile),
        "PNG": ((folder / "a.png").read_bytes(), "a.png", read_image),
        "mask PNG": ((folder / "mask.png").read_bytes(), "a.png", lambda p: read_mask(p, (16, 12))),
        "EXR": ((folder / "a.exr").read_bytes(), "a.exr", read_image),
    }  # fmt: skip


def _read_run(path: Path) -> object:
    """What `History` does with a record: ValueError is its word for one that cannot be read."""
    try:
        return RunRecord.decode(path.read_bytes())
    except ValueError as error:
        raise UntrustedError(str(error)) from error


def _read_profile(path: Path) -> object:
    """What `image_io` does with an embedded profile: these are its words for one that cannot be read."""
    try:
        return read_profile(path.read_bytes())
    except (ValueError, np.linalg.LinAlgError) as error:
        raise UntrustedError(str(error)) from error


def _read_checkpoint(path: Path) -> object:
    """What a stage does with a checkpoint: what is found has a seal that fits, and another byte would break it."""
    if (found := find_checkpoint(path)) is None:
        raise UntrustedError("none is whole")
    changed = bytearray(found.read_bytes())
    changed[-1] ^= 1
    found.write_bytes(changed)
    if find_checkpoint(path) is not None:
        raise AssertionError("a checkpoint with a flipped bit was believed")
    return found


def _read_points(path: Path) -> object:
    return load_points(path)


def fuzz(count: int, seed: int, folder: Path) -> tuple[dict[str, collections.Counter[str]], list[str]]:
    """Target -> how many inputs were read and refused; and what else happened."""
    rng, faults = random.Random(seed), list[str]()
    targets = make_targets(folder)
    counts = {name: collections.Counter[str]() for name in targets}
    for i in range(count):
        name = list(targets)[i % len(targets)]
        good, file, read = targets[name]
        case = folder / "case"
        case.mkdir(exist_ok=True)
        (case / file).write_bytes(mutate(good, rng))
        try:
            read(case / file)
            counts[name]["read"] += 1
        except UntrustedError:
            counts[name]["refused"] += 1
        except Inpaint3dError as error:
            counts[name]["refused" if error.exit_code != Inpaint3dError.exit_code else "failed"] += 1
        except Exception as error:  # what must not happen, whatever it is
            counts[name]["failed"] += 1
            faults.append(f"{name}: {type(error).__name__}: {error!s:.200}: {(case / file).read_bytes()[:2000]!r}")
    return counts, faults


@contextlib.contextmanager
def silence_libraries() -> Iterator[None]:
    """Drop what libpng and others write to standard error of each picture that they refuse."""
    kept = os.dup(2)
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def report(counts: dict[str, collections.Counter[str]]) -> dict[str, Any]:
    return {name: dict(sorted(outcomes.items())) for name, outcomes in counts.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="a JSON file with a section of each of these programs")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, silence_libraries():
        counts, faults = fuzz(given.count, given.seed, Path(folder))
    conclude("damaged inputs", {"seed": given.seed, "inputs": report(counts)}, faults, given.out)


if __name__ == "__main__":
    main()
