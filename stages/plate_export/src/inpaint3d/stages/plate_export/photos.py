"""The photos that plates are made from and of, decoded when they are asked for, and kept as long as they fit."""

from collections import OrderedDict
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.stages.plate_export.lens import Floats
from inpaint3d.stages.plate_export.photo_files import Codes, Colours, PhotoFile, read_photo, to_colours
from inpaint3d.stages.plate_export.views import PlateView

ROW = 1024  # places in a row of what OpenCV is given: its pictures have at most 32767 columns


class Photos:
    """Pictures by view: the photo, or the plate that was made of it. At most `budget` bytes of photos are kept."""

    def __init__(self, views: Iterable[PlateView], budget: int) -> None:
        self._paths = {v.name: v.file for v in views}
        self._budget = budget
        self._kept: OrderedDict[tuple[str, int], Codes] = OrderedDict()
        self._plates: dict[str, Codes] = {}
        self._files: dict[str, PhotoFile] = {}

    def file(self, name: str) -> PhotoFile:
        if name not in self._files:
            self.codes(name)
        return self._files[name]

    def codes(self, name: str) -> Codes:
        """The photo's own channels [h, w, c]; not to be changed."""
        if (found := self._find((name, 1))) is None:
            found, self._files[name] = read_photo(self._paths[name])
            self._keep((name, 1), found)
        return found

    def put_plate(self, name: str, codes: Codes) -> None:
        """Keep a plate, to be sampled by `sample(..., plate=True)`."""
        self._plates[name] = codes

    def drop_plate(self, name: str) -> None:
        """Let a plate go that nobody takes from."""
        self._plates.pop(name, None)

    def reduced(self, name: str, cell: int) -> Colours:
        """The photo's colours by area averages over cells of that many pixels [h / cell, w / cell, colours]."""
        if (found := self._find((name, cell))) is None:
            found = reduce_area(self.codes(name)[..., : self.file(name).colours], cell)
            self._keep((name, cell), found)
        return to_colours(found)

    def sample(self, name: str, xy: Floats, cell: int = 1, *, plate: bool = False) -> Colours:
        """Colours [n, colours] at pixels `xy` [n, 2] of a photo, cubic, of averages over cells of `cell` pixels."""
        if plate:
            codes = self._plates[name][..., : self.file(name).colours]
            source = codes if cell == 1 else reduce_area(codes, cell)
        elif cell == 1:
            source = self.codes(name)[..., : self.file(name).colours]
        else:
            source = self.reduced(name, cell)
        height, width = self.codes(name).shape[:2]
        return sample_cubic(source, xy * (source.shape[1] / width, source.shape[0] / height))

    def _find(self, key: tuple[str, int]) -> Codes | None:
        if key in self._kept:
            self._kept.move_to_end(key)
        return self._kept.get(key)

    def _keep(self, key: tuple[str, int], codes: Codes) -> None:
        self._kept[key] = codes
        while len(self._kept) > 2 and sum(c.nbytes for c in self._kept.values()) > self._budget:
            self._kept.popitem(last=False)


def reduce_area(codes: Codes, cell: int) -> Codes:
    """Averages over cells of `cell` pixels, of the same kind as `codes` [h, w, c]; the last cells may be cut short."""
    height, width = (max(1, round(side / cell)) for side in codes.shape[:2])
    given = codes.astype(np.float32) if codes.dtype == np.float16 else np.ascontiguousarray(codes)
    made = cv2.resize(given, (width, height), interpolation=cv2.INTER_AREA).reshape(height, width, -1)
    return made.astype(codes.dtype)


def sample_cubic(codes: Codes, xy: Floats) -> Colours:
    """Values [n, c] of `codes` [h, w, c] at pixels `xy` [n, 2] (centres at +0.5), in 0 to 1 or light, by cubics."""
    count, channels = len(xy), codes.shape[-1]
    if count == 0:
        return np.zeros((0, channels), np.float32)
    x0, y0 = (max(int(np.floor(xy[:, axis].min())) - 3, 0) for axis in (0, 1))
    x1, y1 = (int(np.ceil(xy[:, axis].max())) + 4 for axis in (0, 1))
    x0, y0 = min(x0, codes.shape[1] - 1), min(y0, codes.shape[0] - 1)
    crop = to_colours(codes[y0 : max(y1, y0 + 1), x0 : max(x1, x0 + 1)])
    maps: NDArray[np.float32] = np.zeros((2, -(-count // ROW) * ROW), np.float32)
    maps[:, :count] = (xy - (x0 + 0.5, y0 + 0.5)).T
    x, y = maps.reshape(2, -1, ROW)
    made = cv2.remap(crop, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(made, np.float32).reshape(-1, channels)[:count]
