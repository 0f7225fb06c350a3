"""Short clips in MP4 (ISO 14496-12), with what cameras write into them and OpenCV's writer does not."""

import struct
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

TURNS = {90: (0, 1, -1, 0), 180: (-1, 0, 0, -1), 270: (0, -1, 1, 0)}
PQ, HLG = 16, 18  # transfer characteristics (ITU-T H.273, table 3)
ENTRY = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd")


def write_clip(path: Path, pictures: Iterable[np.ndarray], rate: float = 10) -> None:
    """Pictures uint8 [h, w, 3], RGB, in MPEG-4's own codec."""
    writer = None
    for picture in pictures:
        height, width = picture.shape[:2]
        writer = writer or cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
        writer.write(picture[..., ::-1])
    if writer is not None:
        writer.release()


def turn_clip(path: Path, degrees: int) -> None:
    """Have it shown turned clockwise, as a phone that was held another way notes it (tkhd, 8.3.2)."""
    data = path.read_bytes()
    a, b, c, d = (v * 0x10000 for v in TURNS[degrees])
    at = data.index(b"tkhd") + 44
    matrix = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 0x40000000)
    path.write_bytes(data[:at] + matrix + data[at + len(matrix) :])


def tag_clip(path: Path, transfer: int) -> None:
    """Say that its codes are BT.2020 with a transfer function (colr, 12.1.5); its data must lie before its index."""
    data = bytearray(path.read_bytes())
    colour = struct.pack(">I4s4sHHHB", 19, b"colr", b"nclx", 9, transfer, 9, 0)
    start, end, sizes = 0, len(data), list[int]()
    for name in ENTRY:
        start, end = _find(data, name, start, end)
        sizes.append(start)
        start += 8
    entry = start + 8  # the first sample entry, after stsd's version and count
    (size,) = struct.unpack_from(">I", data, entry)
    for at in (*sizes, entry):
        struct.pack_into(">I", data, at, struct.unpack_from(">I", data, at)[0] + len(colour))
    data[entry + size : entry + size] = colour
    path.write_bytes(data)


def _find(data: bytearray, name: bytes, start: int, end: int) -> tuple[int, int]:
    """Where the first box of a name begins and ends."""
    while start < end:
        size, found = struct.unpack_from(">I4s", data, start)
        if found == name:
            return start, start + size
        start += size
    raise ValueError(f"no box {name!r}")
