"""Pictures as the prior may see them: known pixels only, cut into squares with holes.

The leak rule lives here: what lies under a mask is overwritten when a frame is read, before anything is resized or
averaged, and every crop carries the pixels that it touched so that they are neither shown nor taught.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import ImageCorpus, MaskSet, PosedCapture
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.masks import random_masks
from inpaint3d.diffusion.training import Batch
from inpaint3d.scene.capture_io import load_posed
from inpaint3d.scene.colour import from_bytes
from inpaint3d.scene.image_io import Image, Mask, read_mask, read_stored
from inpaint3d.stages.diffusion_training.config import MaskMix

HELD_OUT_EVERY = 8
"""Every so many training frames stand in as held-out ones where the capture has no test frames."""
TRIES = 6
MAX_UNKNOWN = 0.5


@dataclass(frozen=True, eq=False)
class KnownPicture:
    """colour float32 [h, w, 3] in [-1, 1], 0 where unknown, or uint8 codes where all is known; unknown bool [h, w];
    hole: the mask alone, bool [h, w].
    """

    name: str
    colour: Image | NDArray[np.uint8]
    unknown: Mask
    hole: Mask

    def cut(self, window: tuple[slice, slice]) -> Image:
        """The colours of a window, float32 in [-1, 1]."""
        part = self.colour[window]
        return from_bytes(part) * 2 - 1 if part.dtype == np.uint8 else part.astype(np.float32, copy=False)


def known_pictures(
    posed: Artifact[PosedCapture], masks: Artifact[MaskSet]
) -> tuple[list[KnownPicture], list[KnownPicture]]:
    """(training, held-out) frames of the capture without the pixels under their masks.

    Raises BadInputError where a frame has no mask, or nothing known is left to learn from.
    """
    mask_of = {view.name: view.mask for view in masks.metadata.views}
    sets: dict[str, list[KnownPicture]] = {"train": [], "test": []}
    for view in load_posed(posed):
        if view.name not in mask_of:
            raise BadInputError(f"frame {view.name} has no mask in the mask set; re-run mask-authoring on this capture")
        size = (view.camera.width, view.camera.height)
        hole = read_mask(masks.root / mask_of[view.name], size)
        sets[view.split].append(_make_known(view.name, view.image(), hole, hole | ~view.valid()))
    training, held_out = sets["train"], sets["test"]
    if not held_out:
        held_out = training[::HELD_OUT_EVERY]
        training = [p for i, p in enumerate(training) if i % HELD_OUT_EVERY] or training
    if not training or min(float(p.unknown.mean()) for p in training) > MAX_UNKNOWN:
        raise BadInputError(
            f"{len(training)} training frames, none with half of its pixels known: a prior cannot be learnt from "
            "them; use a smaller mask, or wire a pretrained prior and set steps to 0"
        )
    return training, held_out


@dataclass(frozen=True)
class StoredPicture:
    """A picture of a corpus, decoded when it is drawn: a corpus need not fit into memory. All its pixels are known."""

    name: str
    path: Path

    def read(self) -> KnownPicture:
        stored = read_stored(self.path)
        nothing = np.zeros(stored.shape[:2], bool)
        # Pixels stay 8-bit until they are cropped: converting all of a large picture costs as much as decoding it.
        return KnownPicture(self.name, stored if stored.dtype == np.uint8 else stored * 2 - 1, nothing, nothing)


Picture = KnownPicture | StoredPicture


def corpus_pictures(
    corpus: Artifact[ImageCorpus] | None, split: Literal["train", "test"] = "train"
) -> list[StoredPicture]:
    """The pictures of a split of an image corpus; those of `test` are for judging alone."""
    if corpus is None:
        return []
    return [StoredPicture(p.name, corpus.root / p.path) for p in corpus.metadata.pictures if p.split == split]


def read_all(pictures: Sequence[Picture]) -> list[KnownPicture]:
    """The pictures decoded, by all cores: for a corpus that fits into memory and a device that does not wait."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(lambda p: p.read() if isinstance(p, StoredPicture) else p, pictures))


def _make_known(name: str, image: Image, hole: Mask, unknown: Mask) -> KnownPicture:
    colour = image * 2 - 1
    colour[unknown] = 0
    return KnownPicture(name, colour, unknown, hole)


@dataclass(frozen=True, eq=False)
class Cropper:
    """Random squares of `size` pixels with random holes."""

    size: int
    share: tuple[float, float]
    mix: MaskMix
    shapes: Sequence[Mask]
    """Masks of the capture: their shapes serve as holes elsewhere."""
    whole_share: float = 0.0
    """How many crops are the largest square of their picture instead."""
    enlarged: float = 1.0
    """By how much a crop may be enlarged, at least 1."""

    def batch(self, pictures: Sequence[Picture], rng: np.random.Generator) -> Batch:
        """One crop of each picture; unknown pixels lie in the hole and are not taught.

        Raises BadInputError where known colours of a crop are not finite, which names the picture.
        """
        known = (picture.read() if isinstance(picture, StoredPicture) else picture for picture in pictures)
        crops = [self._crop(picture, rng) for picture in known]
        for picture, (colour, unknown) in zip(pictures, crops, strict=True):
            if broken := int((~np.isfinite(colour[~unknown])).sum()):
                raise BadInputError(f"picture {picture.name} holds {broken} numbers that are not finite; save it anew")
        colour, unknown = (np.stack(parts) for parts in zip(*crops, strict=True))
        hole = np.stack([self._draw_hole(rng) for _ in pictures]) | unknown
        return Batch(
            image=torch.from_numpy(colour).permute(0, 3, 1, 2).contiguous(),
            hole=torch.from_numpy(hole)[:, None].float(),
            teach=torch.from_numpy(~unknown)[:, None].float(),
        )

    def _crop(self, picture: KnownPicture, rng: np.random.Generator) -> tuple[Image, Mask]:
        """(colour, unknown) of a random square, mirrored half the time; mostly unknown ones are drawn again."""
        best: tuple[float, Image, Mask] | None = None
        for _ in range(TRIES):
            colour, unknown = self._square(picture, rng)
            share = float(unknown.mean())
            if best is None or share < best[0]:
                best = (share, colour, unknown)
            if share <= MAX_UNKNOWN:
                break
        assert best is not None  # noqa: S101 - TRIES is at least 1
        return best[1], best[2]

    def _square(self, picture: KnownPicture, rng: np.random.Generator) -> tuple[Image, Mask]:
        height, width = picture.unknown.shape
        short = min(height, width)
        share = float(np.exp(rng.uniform(*np.log(np.maximum(self.share, 1e-3)))))
        side = short if rng.random() < self.whole_share else round(short * share)
        # Enlarged pictures are blurred, and a prior learns that: no more than was asked for, where the frame allows.
        side = min(short, max(side, round(self.size / self.enlarged)))
        y, x = (int(rng.integers(extent - side + 1)) for extent in (height, width))
        window = np.s_[y : y + side, x : x + side]
        flip = np.s_[:, ::-1] if rng.random() < 0.5 else np.s_[:]
        unknown = self._resize(picture.unknown[window].astype(np.float32)) > 0
        colour = self._resize(picture.cut(window))
        return np.ascontiguousarray(colour[flip]), np.ascontiguousarray(unknown[flip])

    def _resize(self, array: NDArray[np.float32]) -> NDArray[np.float32]:
        # INTER_AREA is an average when it shrinks, but when it enlarges little better than repeating pixels.
        method = cv2.INTER_AREA if array.shape[0] >= self.size else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(array, (self.size, self.size), interpolation=method), np.float32)

    def _draw_hole(self, rng: np.random.Generator) -> Mask:
        shares = {"rectangles": self.mix.rectangles, "strokes": self.mix.strokes, "blobs": self.mix.blobs}
        drawn = {kind: share for kind, share in shares.items() if share > 0}
        if not drawn or (self.shapes and rng.random() < self.mix.own):
            return self._move_shape(rng)
        total = sum(drawn.values())
        return random_masks(1, self.size, rng, {kind: share / total for kind, share in drawn.items()})[0]

    def _move_shape(self, rng: np.random.Generator) -> Mask:
        """The shape of one of the capture's masks, moved, a quarter to three quarters of the square large."""
        shape = self.shapes[int(rng.integers(len(self.shapes)))]
        scale = rng.uniform(0.25, 0.75) * self.size / max(shape.shape)
        width, height = (max(1, round(scale * extent)) for extent in shape.shape[::-1])
        small = cv2.resize(shape.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
        canvas = np.zeros((3 * self.size, 3 * self.size), bool)
        y, x = (int(rng.integers(self.size - extent // 2, 2 * self.size - extent // 2)) for extent in (height, width))
        canvas[y : y + height, x : x + width] = small > 0
        return canvas[self.size : 2 * self.size, self.size : 2 * self.size]


def mask_shapes(pictures: Sequence[KnownPicture]) -> list[Mask]:
    """The capture's masks, cut to their bounding boxes; masks of almost nothing or almost everything are left out."""
    shapes = []
    for picture in pictures:
        if 0.001 < picture.hole.mean() < 0.7:
            rows, columns = (np.flatnonzero(picture.hole.any(axis=axis)) for axis in (1, 0))
            shapes.append(picture.hole[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
    return shapes
