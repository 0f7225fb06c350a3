"""What a plate is made from: the photo's camera and hole, and what completion made of the view at its own size."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import Capture, CompletedViews, MaskSet, PosedCapture
from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.capture_io import load_posed
from inpaint3d.scene.image_io import Image, Mask, read_image, read_mask
from inpaint3d.scene.map_io import read_codes, read_exr
from inpaint3d.scene.morphology import grow
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.scene.visibility import enlarge_depth
from inpaint3d.stages.plate_export.lens import Floats, PhotoCamera

SEEN_WITHIN = 0.03
"""Relative difference of depths up to which a view sees a surface, and not something before or behind it."""


@dataclass(frozen=True, eq=False)
class PlateView:
    """A photo's view: hole, known and sources [h, w] and picture [h, w, 3] of the posed view's size.

    picture: sRGB-encoded, completed; sources: `CompletedView.sources`, whose photos are numbers of `photos`. disparity:
    1 / z [h', w'] of its cells, surface of the hole completed. copies: pixel [h, w, 2] that each was copied from, -1
    elsewhere; None where nothing was.
    """

    name: str
    camera: PhotoCamera
    file: Path
    hole: Mask
    known: Mask
    picture: Image
    sources: NDArray[np.uint16]
    disparity: NDArray[np.float64]
    copies: NDArray[np.float32] | None = None
    completed: bool = True
    """Whether completion saw this view; what a held-out one lacks is taken from those that it saw."""

    def disparity_at(self, rays: Floats) -> Floats:
        """1 / z [*n] of the surface behind rays [*n, 2]."""
        at = self.camera.to_posed(rays)
        return sample_bilinear(self._fine_disparity[..., None], at)[..., 0].astype(np.float64)

    @cached_property
    def _fine_disparity(self) -> NDArray[np.float32]:
        return (1 / enlarge_depth(1 / self.disparity, self.hole.shape)).astype(np.float32)

    def sees(self, rays: Floats, z: Floats) -> Mask:
        """Whether points at depth z [*n] behind rays [*n, 2] are what the view shows there."""
        posed = self.camera.to_posed(rays)
        inside = self.camera.posed.inside(posed, z)
        return inside & (np.abs(self.disparity_at(rays) * np.where(z > 0, z, 0) - 1) < SEEN_WITHIN)

    def knows(self, rays: Floats) -> Mask:
        """Whether the photo itself shows what is behind rays [*n, 2]: nothing of the hole, not even at an edge."""
        posed = self.camera.to_posed(rays)
        inside = self.camera.posed.inside(posed, np.ones(posed.shape[:-1]))
        x, y = (np.where(inside, posed[..., axis], 0).astype(np.int64) for axis in (0, 1))
        return inside & self._surely_known[y, x]

    @cached_property
    def _surely_known(self) -> Mask:
        return ~grow(~self.known, 1)

    def covers(self, rays: Floats) -> Mask:
        """Whether rays [*n, 2] end in the hole, drawn smoothly between the posed view's pixels and never too small."""
        shares = sample_bilinear(self.hole[..., None].astype(np.float32), self.camera.to_posed(rays))[..., 0]
        return shares > HOLE_FROM


HOLE_FROM = 0.25
"""Share of the hole between the nearest four pixels of the posed view from which on a pixel of the photo is filled."""


def load_views(
    capture: Artifact[Capture],
    posed: Artifact[PosedCapture],
    masks: Artifact[MaskSet],
    completed: Artifact[CompletedViews],
) -> list[PlateView]:
    """Every posed photo; BadInputError where an input is of another capture. Sources count photos as in this list."""
    frames = {f.name: f for f in capture.metadata.frames}
    holes = {m.name: m for m in masks.metadata.views}
    made = {v.name: v for v in completed.metadata.views}
    order = [f.name for f in posed.metadata.frames]
    for what, names in (("the capture", frames), ("the mask set", holes)):
        if missing := [name for name in order if name not in names]:
            raise BadInputError(f"{what} has no {missing[0]}; it belongs to another capture")
    if missing := [name for name in made if name not in order]:
        raise BadInputError(f"completed view {missing[0]} is not of this capture; re-run view-completion on it")
    numbers = np.array([order.index(name) for name in made], np.int64)
    views: list[PlateView] = []
    for record, view in zip(posed.metadata.frames, load_posed(posed), strict=True):
        frame = frames[record.name]
        size = (record.width, record.height)
        hole = read_mask(masks.path(holes[record.name].mask), size)
        known = view.valid() & ~hole
        camera = PhotoCamera.from_frame(record, posed.metadata.lens, frame.width, frame.height)
        file = capture.path(frame.original or frame.path)
        if (done := made.get(record.name)) is None or done.depth is None:
            blank = np.where(known[..., None], view.image(), np.float32(0))
            views.append(
                PlateView(record.name, camera, file, hole, known, blank, np.zeros(hole.shape, np.uint16),
                          np.zeros((1, 1)), completed=False)
            )  # fmt: skip
            continue
        sources = read_codes(completed.path(done.sources)).astype(np.int64)
        views.append(
            PlateView(
                record.name,
                camera,
                file,
                hole,
                known,
                read_image(completed.path(done.picture)),
                _renumber(sources, numbers),
                1 / read_exr(completed.path(done.depth))["depth.Z"].astype(np.float64),
                None if done.copies is None else _read_copies(completed.path(done.copies)),
            )
        )
    if not any(v.completed for v in views):
        raise BadInputError(
            f"the completed views have no depth (method {completed.metadata.method}); plates are carried by depth: "
            "run with --set view-completion.method=photo-completion"
        )
    return views


def _renumber(sources: NDArray[np.int64], numbers: NDArray[np.int64]) -> NDArray[np.uint16]:
    """Source maps whose photos count as in the posed capture, instead of as in the completed views."""
    first = FIRST_PHOTO
    photo = sources >= first
    return np.where(photo, first + numbers[np.where(photo, sources - first, 0)], sources).astype(np.uint16)


def _read_copies(path: Path) -> NDArray[np.float32]:
    channels = read_exr(path)
    return np.stack([channels["copied.X"], channels["copied.Y"]], -1)
