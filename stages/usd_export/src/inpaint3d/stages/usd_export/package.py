"""A usdz package: an uncompressed zip whose files start at multiples of 64 bytes (USDZ specification 1.3)."""

import zipfile
from collections.abc import Sequence
from pathlib import Path

ALIGNMENT = 64
_HEADER = 30  # bytes of a local file header before the name
_PADDING_ID = b"\x86\x19"  # the extra field that USD's own writer uses
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time that a zip can hold: equal scenes give equal bytes


def write_package(path: Path, files: Sequence[tuple[str, Path]]) -> None:
    """Pack files under the names given; the first must be the root layer. The same files give the same bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=False) as archive:
        offset = 0
        for name, source in files:
            info = zipfile.ZipInfo(name, _EPOCH)
            info.create_system = 0
            info.external_attr = 0
            info.extra = _make_padding(offset + _HEADER + len(name.encode()))
            data = source.read_bytes()
            archive.writestr(info, data)
            offset += _HEADER + len(name.encode()) + len(info.extra) + len(data)


def _make_padding(offset: int) -> bytes:
    """An extra field (four bytes of its own at least) that moves data from `offset` to a multiple of 64."""
    length = -(offset + 4) % ALIGNMENT
    return _PADDING_ID + length.to_bytes(2, "little") + bytes(length)
