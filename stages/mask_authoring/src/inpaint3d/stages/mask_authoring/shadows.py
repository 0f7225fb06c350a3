"""Shadows that what is masked casts on planes of the scene: where they lie, and what speaks for them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.planes import Plane
from inpaint3d.scene.selection import choose_evenly
from inpaint3d.stages.mask_authoring.flat_surface import IN_FRONT, PlaneGrid, Texture, see_surface, slice_hull
from inpaint3d.stages.mask_authoring.illumination import cast_shadows, fit_darkening, move_shadows
from inpaint3d.stages.mask_authoring.views import DepthView

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SIDE = 160  # cells of the grid that a plane is seen on
REACH = 3.0  # of the object's size: how far shadows are looked for
STEP = 2  # cells between the slices of the hull
DARK = 0.1  # share of the light that is kept off, from which on a place may be in the shadow
NEAR = 0.1  # share of the sky hidden by the object, from which on a place is near it
SEEN = 0.3  # share of the places near the object that must be known
FOOT = 12  # cells that the hull covers of a plane that it touches, at least
ELSEWHERE = 8  # places to which the object is moved to see what chance explains
KNOWN = 0.5  # share of the places near it there that must be known
FEWEST = 3  # of these, at least: fewer tell nothing
BETTER = 2.0  # times as much as at any other place must be explained
BEHIND = 0.05  # of the depth: so far behind a plane the field may have its surface


@dataclass(frozen=True, eq=False)
class Shadow:
    """The light that an object keeps from a plane, and what would be found by chance.

    share: of each cell's light [side, side]; gain: how much better that explains the plane's brightness than no shadow
    (log likelihood); chance_share, chance_gain: the most of both that was found for the same object thought elsewhere.
    """

    grid: PlaneGrid
    texture: Texture
    share: Floats
    gain: float
    chance_share: float
    chance_gain: float

    @property
    def threshold(self) -> float:
        """The share of light from which on a place is in the shadow: more than chance makes of the texture."""
        return max(DARK, self.chance_share)

    @property
    def darkest(self) -> float:
        """The largest share of what some view shows."""
        return float(self.share[self.texture.known].max(initial=0.0))

    @property
    def found(self) -> bool:
        return self.gain > BETTER * max(self.chance_gain, 0.0) and self.darkest > self.threshold


def find_shadows(planes: Sequence[Plane], views: Sequence[DepthView], masks: Sequence[Bools]) -> list[Shadow]:
    """What the masked object does to the light on each plane that it touches; with too little to tell from, nothing."""
    if (measured := measure_object(views, masks)) is None:
        return []
    middle, size = measured
    grids = [PlaneGrid.around(p, middle, REACH * size, [v.camera for v in views], SIDE) for p in planes]
    found = [look_for_shadow(grid, views, masks) for grid in grids]
    return [shadow for shadow in found if shadow is not None]


def measure_object(views: Sequence[DepthView], masks: Sequence[Bools]) -> tuple[Floats, float] | None:
    """Where it is [3] and how large, scene units: medians over the views of their masks' depth; None without depth."""
    middles, sizes = [], []
    for view, mask in zip(views, masks, strict=True):
        pixels = np.argwhere(mask)[:, ::-1] + 0.5
        depth = view.depth_at(pixels)
        known = np.isfinite(depth)
        if known.any():
            z = float(np.median(depth[known]))
            middles.append(view.camera.unproject(np.median(pixels, 0)[None], np.array([z]))[0])
            sizes.append(z * float(np.sqrt(mask.sum())) / view.camera.fx)
    return (np.median(middles, 0), float(np.median(sizes))) if middles else None


def look_for_shadow(grid: PlaneGrid, views: Sequence[DepthView], masks: Sequence[Bools]) -> Shadow | None:
    """The shadow on one plane; None where the object doesn't touch it, or too little of it is seen."""
    slices = slice_hull(grid, views, masks, STEP)
    if not slices or slices[0].sum() < FOOT:
        return None
    texture = see_surface(grid, views, masks)
    cast = cast_shadows(slices, STEP)
    usable = texture.known & ~slices[0]
    near = (cast[0] > NEAR) & ~slices[0]
    if usable[near].mean() < SEEN or (darkening := fit_darkening(texture, usable, cast)) is None:
        return None
    by_chance = fit_elsewhere(texture, usable & (darkening.share < DARK), cast, slices[0])
    if len(by_chance) < FEWEST:
        return None
    shares, gains = zip(*by_chance, strict=True)
    return Shadow(grid, texture, darkening.share, darkening.gain, max(shares), max(gains))


def fit_elsewhere(texture: Texture, usable: Bools, cast: Floats, foot: Bools) -> list[tuple[float, float]]:
    """The largest share of light, and the gain, with the object thought at other places, where it does not stand."""
    found: list[tuple[float, float]] = []
    near = cast[0] > NEAR
    for shift in choose_evenly(list_places(usable, near, foot), ELSEWHERE):
        free = usable & ~(move_shadows(foot[None].astype(np.float64), shift)[0] > 0)
        if (fitted := fit_darkening(texture, free, move_shadows(cast, shift))) is not None:
            found.append((float(fitted.share[free].max()), fitted.gain))
    return found


def list_places(usable: Bools, near: Bools, foot: Bools) -> list[Floats]:
    """Shifts (columns, rows) in cells that move a foot off itself, to where enough of what is near it is usable."""
    rows, columns = np.nonzero(foot)
    width = int(max(np.ptp(rows), np.ptp(columns))) + 1
    steps = range(-SIDE // 2, SIDE // 2, max(1, width // 2))
    shifts = [np.array([x, y], np.float64) for y in steps for x in steps if max(abs(x), abs(y)) >= width]
    known = [usable & (move_shadows(near[None].astype(np.float64), shift)[0] > 0.5) for shift in shifts]
    # What leaves the grid is not known either.
    return [shift for shift, here in zip(shifts, known, strict=True) if here.sum() >= KNOWN * near.sum()]


def show_shadow(shadow: Shadow, view: DepthView) -> Bools:
    """Pixels [h, w] of a view that show the plane in the shadow."""
    pixels = view.camera.pixel_centres()
    depth = shadow.grid.plane.depth(view.camera, pixels.reshape(-1, 2)).reshape(pixels.shape[:2])
    off = np.where(np.isfinite(depth), view.depth_at(pixels) / np.where(np.isfinite(depth), depth, 1.0) - 1, np.inf)
    on_it = (off > -IN_FRONT) & (off < BEHIND)
    points = view.camera.unproject(pixels, np.where(on_it, depth, 1.0))
    return on_it & (shadow.grid.look_up(shadow.share, points) > shadow.threshold)
