"""How well a field shows views that it was not fitted to: known pixels only."""

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray

from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rays import Rays, camera_rays
from inpaint3d.radiance.rendering import render
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.psnr import mean_psnr, psnr

Colours = Float[np.ndarray, "n 3"]


class KnownPhoto(NamedTuple):
    """A photo [h, w, 3] in [0, 1], and which of its pixels count, bool [h, w]."""

    camera: Camera
    image: NDArray[np.float32]
    known: NDArray[np.bool_]

    @classmethod
    def of(cls, view: View) -> "KnownPhoto":
        """All of a posed view that it really has, read from its files."""
        return cls(view.camera, view.image(), view.valid())


class HeldOut:
    """Some known pixels of each held-out photo: whole pictures would cost more than the steps between two scores.

    Nothing is averaged down, since a small picture would score higher than the large one that it stands for.
    """

    def __init__(self, pixels: Iterable[tuple[Rays, Colours]]) -> None:
        self._views = [(rays, truth) for rays, truth in pixels if len(truth)]

    @classmethod
    def on_lattice(cls, photos: Iterable[KnownPhoto], longest_side: int, device: torch.device | str) -> "HeldOut":
        """The known pixels of a regular lattice with about `longest_side` pixels along the longest side."""
        return cls(_sample_lattice(photo, longest_side, device) for photo in photos)

    @classmethod
    def at_random(cls, photos: Iterable[KnownPhoto], pixels: int, device: torch.device | str) -> "HeldOut":
        """A random choice of at most `pixels` known pixels of each photo, always the same one."""
        return cls(_draw_pixels(photos, pixels, device))

    def psnr(self, field: RadianceField, block: int) -> float | None:
        """Mean over the photos of their PSNR in dB, mean appearance code; None where no photo has a known pixel.

        Photos that the field equals are not in it (`mean_psnr`). block: rays rendered at once.
        """
        return mean_psnr(self.psnr_of_each(field, block))

    def psnr_of_each(self, field: RadianceField, block: int) -> list[float]:
        """The PSNR of each photo that has a known pixel, dB."""
        return [_score(field, rays, truth, block) for rays, truth in self._views]


def _sample_lattice(photo: KnownPhoto, longest_side: int, device: torch.device | str) -> tuple[Rays, Colours]:
    step = max(1, math.ceil(max(photo.camera.width, photo.camera.height) / longest_side))
    lattice = np.s_[step // 2 :: step, step // 2 :: step]
    known = photo.known[lattice]
    xy = photo.camera.pixel_centres()[lattice][known]
    return camera_rays(photo.camera, xy, device=device), photo.image[lattice][known]


def _draw_pixels(
    photos: Iterable[KnownPhoto], pixels: int, device: torch.device | str
) -> Iterator[tuple[Rays, Colours]]:
    rng = np.random.default_rng(0)
    for photo in photos:
        y, x = np.nonzero(photo.known)
        if len(x):
            chosen = rng.choice(len(x), min(pixels, len(x)), replace=False)
            xy = np.stack([x[chosen] + 0.5, y[chosen] + 0.5], -1)
            yield camera_rays(photo.camera, xy, device=device), photo.image[y[chosen], x[chosen]]


@torch.no_grad()
def _score(field: RadianceField, rays: Rays, truth: Colours, block: int) -> float:
    parts = [render(field, rays[start : start + block], glo="mean").rgb for start in range(0, len(truth), block)]
    return psnr(torch.cat(parts).clamp(0, 1).cpu().numpy(), truth)
