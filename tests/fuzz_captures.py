"""Captures damaged at random: each is read, or refused with exit code 3; nothing else happens.

Usage: python -m tests.fuzz_captures --count 20000 [--first SEED] [--out FILE.json]
"""

import argparse
import contextlib
import faulthandler
import json
import random
import shutil
import signal
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.map_io import write_exr
from inpaint3d.stages.capture_ingest.carry import carry
from inpaint3d.stages.capture_ingest.config import Config
from inpaint3d.stages.capture_ingest.layouts import find
from tests.colour_profiles import DISPLAY_P3, SRGB_CURVE, matrix_profile
from tests.data_sets import (
    SCENE,
    nerfstudio_frames,
    write_colmap_binary,
    write_colmap_text,
    write_llff,
    write_nerfstudio,
)
from tests.faults.results import conclude

SECONDS = 20  # a case takes hundredths of one
NAMES = [f"images/a_{i}.png" for i in range(3)]
VALUES: list[Any] = [
    None, True, -1, 0, 1, 1e300, -1e-300, float("nan"), float("inf"), 10**400, "", ".", "..", "/", "/etc/passwd",
    "../outside/b.png", "images", "images/a_0.png", "a\0b", "\ud800", [], {}, [[]], [1, 2, 3], "x" * 5000,
]  # fmt: skip
INTEGERS = [0, 1, 2**15, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**62, 2**63 - 1, 2**64 - 1]


@dataclass(frozen=True)
class Kind:
    """A capture, the file of it that is damaged, and how."""

    file: str
    write: Callable[[Path], object]
    mutate: Callable[[bytes, random.Random], bytes]


def damage_bytes(data: bytes, rng: random.Random) -> bytes:
    """A few bytes flipped, replaced by extremes, cut out, doubled; or the rest of the file gone."""
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 4, 16])):
        # Headers hold what is believed.
        at = rng.randrange(min(len(changed), rng.choice([32, 256, len(changed)])) or 1)
        match rng.randrange(6):
            case 0 if changed:
                changed[at % len(changed)] ^= 1 << rng.randrange(8)
            case 1:
                changed[at : at + 1] = bytes([rng.randrange(256)])
            case 2:
                width, order = rng.choice([("H", 2), ("I", 4), ("Q", 8)]), rng.choice("<>")
                value = rng.choice(INTEGERS) & (1 << 8 * width[1]) - 1
                changed[at : at + width[1]] = struct.pack(order + width[0], value)
            case 3:
                del changed[at : at + rng.randrange(1, 64)]
            case 4:
                changed[at:at] = changed[at : at + rng.randrange(1, 64)]
            case _:
                if rng.random() < 0.2:
                    del changed[at:]
    return bytes(changed)


def damage_json(data: bytes, rng: random.Random) -> bytes:
    """A value of the document replaced, dropped or doubled, wherever it lies; or its bytes damaged."""
    if rng.random() < 0.3:
        return damage_bytes(data, rng)
    document = json.loads(data)
    for _ in range(rng.choice([1, 1, 2, 5])):
        owner, key = rng.choice(list(_places(document)))
        match rng.randrange(4):
            case 0 if isinstance(owner, dict):
                owner.pop(key, None)
            case 1 if isinstance(owner, list):
                owner.append(owner[key])
            case 2 if isinstance(owner, dict):
                owner[rng.choice(["mask_path", "camera_model", "k1", "k3", "w", "is_fisheye", "fl_x"])] = rng.choice(
                    VALUES
                )
            case _:
                owner[key] = rng.choice(VALUES)
    return json.dumps(document).encode()


def _places(node: Any) -> Iterator[tuple[Any, Any]]:
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in list(items):
        yield node, key
        yield from _places(value)


def damage_text(data: bytes, rng: random.Random) -> bytes:
    """A word of a line replaced, a line dropped or doubled; or bytes damaged."""
    if rng.random() < 0.3:
        return damage_bytes(data, rng)
    lines = data.decode().split("\n")
    for _ in range(rng.choice([1, 1, 3])):
        at = rng.randrange(len(lines))
        words = lines[at].split(" ")
        match rng.randrange(4):
            case 0 if len(lines) > 1:
                del lines[at]
            case 1:
                lines.insert(at, lines[at])
            case _:
                words[rng.randrange(len(words))] = str(rng.choice(VALUES))
                lines[at : at + 1] = [" ".join(words)]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _pictures(root: Path) -> None:
    for name, image in zip(NAMES, SCENE.images, strict=False):
        write_png(root / name, image)


def _nerfstudio(root: Path) -> None:
    frames = nerfstudio_frames(NAMES)
    frames[1] |= {"mask_path": NAMES[0], "fl_x": 40.0}
    write_nerfstudio(root, frames, camera_model="OPENCV", k1=0.01)


def _picture(suffix: str) -> Callable[[Path], None]:
    """A picture that carries a profile, an orientation and alpha as far as its format has them."""

    def write(root: Path) -> None:
        path = root / "images" / f"b{suffix}"
        if suffix == ".exr":
            write_exr(path, dict(zip("RGBA", np.moveaxis(SCENE.images[0][..., [0, 1, 2, 0]], -1, 0), strict=True)))
            return
        from PIL import Image

        picture = Image.fromarray((255 * SCENE.images[0]).astype(np.uint8))
        exif = Image.Exif()
        exif[0x0112] = 6
        picture = picture.convert("RGBA") if suffix == ".png" else picture
        picture.save(path, exif=exif, icc_profile=matrix_profile(DISPLAY_P3, SRGB_CURVE))

    return write


KINDS = {
    "transforms.json": Kind("transforms.json", _nerfstudio, damage_json),
    "COLMAP cameras.bin": Kind(
        "sparse/0/cameras.bin", lambda r: write_colmap_binary(r / "sparse/0", _stems()), damage_bytes
    ),
    "COLMAP images.bin": Kind(
        "sparse/0/images.bin", lambda r: write_colmap_binary(r / "sparse/0", _stems()), damage_bytes
    ),
    "COLMAP cameras.txt": Kind(
        "sparse/0/cameras.txt", lambda r: write_colmap_text(r / "sparse/0", _stems()), damage_text
    ),
    "COLMAP images.txt": Kind(
        "sparse/0/images.txt", lambda r: write_colmap_text(r / "sparse/0", _stems(), said=3), damage_text
    ),
    "poses_bounds.npy": Kind("poses_bounds.npy", lambda r: write_llff(r, range(3)), damage_bytes),
    **{
        suffix: Kind(f"images/b{suffix}", _picture(suffix), damage_bytes) for suffix in (".jpg", ".png", ".exr", ".tif")
    },
}


def _stems() -> list[str]:
    return [name.removeprefix("images/") for name in NAMES]


class FuzzError(Exception):
    """A damaged capture did what none may."""


_opened: list[str] = []


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and isinstance(arguments[0], str | bytes):
        _opened.append(arguments[0] if isinstance(arguments[0], str) else arguments[0].decode("utf-8", "replace"))


@contextlib.contextmanager
def _limited(seconds: int) -> Iterator[None]:
    def stop(*_: object) -> None:
        raise FuzzError(f"it takes longer than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def read_capture(root: Path, work: Path) -> str:
    """What becomes of it: "read" or "refused". FuzzError for anything else."""
    _opened.clear()
    outcome = "read"
    try:
        with _limited(SECONDS):
            found = find(root, Config(), work)
            for frame in found.frames:
                carry(frame, work / "out")
    except BadInputError:
        outcome = "refused"
    except FuzzError:
        raise
    except BaseException as error:
        raise FuzzError(f"{type(error).__name__}: {error}") from error
    inside = (str(root.parent), sys.prefix, sys.base_prefix)
    if strange := [path for path in _opened if path.startswith("/") and not path.startswith(inside)]:
        raise FuzzError(f"it opened {strange[0]}")
    return outcome


def fuzz(count: int, first: int = 0) -> Counter[tuple[str, str]]:
    """(kind, outcome) -> how many of `count` cases, seeded from `first` on. FuzzError names the seed and the kind."""
    if _watch not in _hooked:
        sys.addaudithook(_watch)
        _hooked.append(_watch)
    outcomes: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory() as temporary:
        originals = {
            name: _write(Path(temporary) / f"original {i}", kind) for i, (name, kind) in enumerate(KINDS.items())
        }
        for seed in range(first, first + count):
            rng = random.Random(seed)
            name = rng.choice(list(KINDS))
            case = Path(temporary) / "case"
            shutil.copytree(originals[name], case / "raw")
            file = case / "raw" / KINDS[name].file
            file.write_bytes(KINDS[name].mutate(file.read_bytes(), rng))
            try:
                outcomes[name, read_capture(case / "raw", case / "work")] += 1
            except FuzzError as error:
                raise FuzzError(f"seed {seed}, {name}: {error}") from error
            shutil.rmtree(case)
    return outcomes


_hooked: list[object] = []


def _write(root: Path, kind: Kind) -> Path:
    _pictures(root)
    kind.write(root)
    return root


def main() -> None:
    faulthandler.enable()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path, help="a JSON file for what was counted")
    options = parser.parse_args()
    outcomes, faults = Counter[tuple[str, str]](), list[str]()
    try:
        outcomes = fuzz(options.count, options.first)
    except FuzzError as error:
        faults.append(str(error))
    inputs = {name: {outcome: outcomes[name, outcome] for outcome in ("read", "refused")} for name in KINDS}
    figures = {"first seed": options.first, "mutations": outcomes.total(), "inputs": inputs}
    conclude("damaged captures", figures, faults, options.out)


if __name__ == "__main__":
    main()
