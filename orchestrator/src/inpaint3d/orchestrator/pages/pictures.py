"""Pictures inside a page: PNG files as data, and panels cut from a strip of them without another copy."""

import base64
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from inpaint3d.contracts.errors import ArtifactError
from inpaint3d.contracts.models.artifacts import PictureStrip

T = TypeVar("T")
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Panel:
    """A part of a strip: its left edge, in pixels."""

    caption: str
    x: int


@dataclass(frozen=True)
class Strip:
    """A strip that is embedded once, under `id`, and shown panel by panel."""

    id: str
    view: str
    uri: str
    width: int
    height: int
    panel_width: int
    panels: tuple[Panel, ...]


def embed(data: bytes) -> str:
    """A PNG file as a data URI."""
    return "data:image/png;base64," + base64.b64encode(data).decode()


def read_size(data: bytes, where: Path) -> tuple[int, int]:
    """Width and height of a PNG file; ArtifactError where it is none."""
    if data[:8] != _SIGNATURE or data[12:16] != b"IHDR":
        raise ArtifactError(f"{where} is no PNG; run the stage that wrote it again")
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def cut_strip(name: str, file: Path, strip: PictureStrip) -> Strip:
    """A strip's file with where its panels lie."""
    data = file.read_bytes()
    width, height = read_size(data, file)
    count = len(strip.captions)
    one = (width + strip.gap) // count - strip.gap
    panels = tuple(Panel(caption, i * (one + strip.gap)) for i, caption in enumerate(strip.captions))
    return Strip(name, strip.view, embed(data), width, height, one, panels)


def fit_into(files: Iterable[Path], budget: int) -> list[Path]:
    """As many files from the front as a budget of bytes takes."""
    taken: list[Path] = []
    for file in files:
        budget -= file.stat().st_size
        if budget < 0:
            break
        taken.append(file)
    return taken


def choose_evenly(items: Sequence[T], count: int) -> list[T]:
    """At most `count` of the items, spread evenly from the first."""
    step = max(1.0, len(items) / max(1, count))
    return [items[int(i * step)] for i in range(min(count, len(items)))]
