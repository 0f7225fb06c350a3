"""Small captures of the synthetic room with one effect put in, at several strengths: what is called for is known."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import EffectPlan
from inpaint3d.scene.capture_io import SparsePoints, View, load_points, write_points, write_view
from inpaint3d.scene.colour import linear_from_srgb, srgb_from_linear
from inpaint3d.scene.synthetic import SyntheticScene, arc_cameras, synthetic_scene

Images = NDArray[np.float32]
VIEWS, WIDTH, HEIGHT, POINTS, ARC = 24, 112, 84, 1500, 90.0
TESTS = (3, 9, 15, 21)
CLEAN = "clean.npy"
PIXEL_NOISE, CLICK_NOISE = 0.006, 0.25  # sRGB of a picture's noise; pixels of a match's


@dataclass(frozen=True)
class Recipe:
    """One capture: which effect, how strong (its own unit), which room."""

    effect: str
    strength: float
    seed: int

    @property
    def name(self) -> str:
        return f"{self.effect}-{self.strength:g}-{self.seed}"


@dataclass(frozen=True, eq=False)
class MadeCapture:
    """views as posed capture has them; clean [t, h, w, 3]: what the test views would show without the effect."""

    recipe: Recipe
    views: list[View]
    points: SparsePoints
    clean: Images

    @property
    def train(self) -> list[View]:
        return [v for v in self.views if v.split == "train"]

    @property
    def test(self) -> list[View]:
        return [v for v in self.views if v.split == "test"]


@dataclass(frozen=True)
class PlanFolder:
    """A plan where its masks lie."""

    metadata: EffectPlan
    root: Path


STRENGTHS: dict[str, tuple[float, ...]] = {
    "exposure": (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8),  # EV, 10 to 90 % of the views
    "view-dependence": (0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5),  # height of a lobe over the diffuse colour
    "contraction": (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 14.0),  # how far the walls stand
    "transients": (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0),  # views that somebody walks through
    "blur": (0.0, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0),  # pixels (sigma) along the motion, in a fifth of the views
}


def list_recipes() -> Iterator[Recipe]:
    """Every effect at every strength in a room of its own, the strengths in turn."""
    for index in range(max(map(len, STRENGTHS.values()))):
        for offset, (effect, strengths) in enumerate(STRENGTHS.items()):
            yield Recipe(effect, strengths[index], 10 * offset + index)


def make(recipe: Recipe, folder: Path) -> MadeCapture:
    """A capture whose pictures lie below a folder; written there the first time."""
    if not (folder / CLEAN).is_file():
        _write(recipe, folder)
    cameras, names = arc_cameras(VIEWS, WIDTH, HEIGHT, ARC), [f"view_{i:03d}" for i in range(VIEWS)]
    views = [
        View(name, camera, "test" if i in TESTS else "train", None, folder / "frames" / f"{name}.png")
        for i, (name, camera) in enumerate(zip(names, cameras, strict=True))
    ]
    return MadeCapture(recipe, views, load_points(folder / "points.safetensors"), np.load(folder / CLEAN))


def _write(recipe: Recipe, folder: Path) -> None:
    scene = _render(recipe.seed, recipe.strength if recipe.effect == "contraction" else 1.0)
    rng = np.random.default_rng(recipe.seed)
    put_in = PUT_IN.get(recipe.effect)
    images, points = scene.images, _click(scene.points, rng)
    if put_in is not None and recipe.strength:
        images, points = put_in(scene, points, recipe.strength, rng)
    noisy = images + rng.normal(0, PIXEL_NOISE, images.shape)
    for name, image, camera in zip(scene.names, noisy, scene.cameras, strict=True):
        write_view(folder, name, np.clip(image, 0, 1).astype(np.float32), camera)
    write_points(folder / "points.safetensors", points)
    # A sheen belongs to what the views show; the rest is put into the camera or before it.
    truth = images if recipe.effect == "view-dependence" else scene.images
    np.save(folder / CLEAN, truth[list(TESTS)])


@lru_cache(maxsize=1)
def _render(seed: int, reach: float) -> SyntheticScene:
    return synthetic_scene(VIEWS, WIDTH, HEIGHT, seed, POINTS, ARC, reach)


def _click(points: SparsePoints, rng: np.random.Generator) -> SparsePoints:
    """Matches as somebody finds them: a fraction of a pixel off."""
    moved = points.track_xy + rng.normal(0, CLICK_NOISE, points.track_xy.shape)
    return replace(points, track_xy=moved.astype(np.float32))


def vary_exposure(
    scene: SyntheticScene, points: SparsePoints, spread: float, rng: np.random.Generator
) -> tuple[Images, SparsePoints]:
    """Gains that wander smoothly, and white balance by a third as much."""
    step = np.arange(VIEWS)
    curve = np.sin(2 * np.pi * step / VIEWS * rng.uniform(1, 2.5) + rng.uniform(0, 6)) + 0.3 * rng.normal(size=VIEWS)
    curve -= np.median(curve)
    curve *= spread / np.diff(np.quantile(curve, (0.1, 0.9)))[0]
    cast = np.stack([0.33 * curve, 0 * curve, -0.33 * curve], -1)
    gains = 2.0 ** (curve[:, None] + cast)
    return _encode(linear_from_srgb(scene.images) * gains[:, None, None]), points


def add_sheen(
    scene: SyntheticScene, points: SparsePoints, height: float, rng: np.random.Generator
) -> tuple[Images, SparsePoints]:
    """A lobe about the mirrored direction of a lamp, on everything that faces up."""
    lamp = np.array([rng.uniform(-0.5, 0.5), 0.9, 1.3])
    images: list[NDArray[np.float64]] = []
    for image, camera, depth in zip(scene.images, scene.cameras, scene.depths, strict=True):
        xyz = camera.unproject(camera.pixel_centres(), depth)
        to_camera, to_lamp = camera.centre - xyz, lamp - xyz
        half = to_camera / np.linalg.norm(to_camera, axis=-1, keepdims=True)
        half = half + to_lamp / np.linalg.norm(to_lamp, axis=-1, keepdims=True)
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        floor = xyz[..., 2] < -0.19
        lobe = np.where(floor, np.clip(half[..., 2], 0, 1) ** 60, 0.0)
        images.append(linear_from_srgb(image) + 0.25 * height * lobe[..., None])
    return _encode(np.stack(images)), points


def let_walk(
    scene: SyntheticScene, points: SparsePoints, views: float, rng: np.random.Generator
) -> tuple[Images, SparsePoints]:
    """Somebody crosses the pictures, a textured upright shape before the scene; matches behind it are lost."""
    images, lost = scene.images.copy(), np.zeros(len(points.track_frame), bool)
    first = int(rng.integers(1, VIEWS - int(views) - 1))
    cloth = cv2.resize(rng.random((12, 4, 3)).astype(np.float32), (WIDTH // 5, HEIGHT), interpolation=cv2.INTER_LINEAR)
    for index in range(first, first + int(views)):
        left = int(rng.integers(0, WIDTH - WIDTH // 5))
        top = int(0.15 * HEIGHT)
        images[index, top:, left : left + WIDTH // 5] = cloth[: HEIGHT - top]
        x, y = points.track_xy[:, 0], points.track_xy[:, 1]
        lost |= (points.track_frame == index) & (x >= left) & (x < left + WIDTH // 5) & (y >= top)
    return images, _drop(points, lost)


def blur_some(
    scene: SyntheticScene, points: SparsePoints, sigma: float, rng: np.random.Generator
) -> tuple[Images, SparsePoints]:
    """A fifth of the training views along one direction, as a hand moves."""
    images = scene.images.copy()
    trains = [i for i in range(VIEWS) if i not in TESTS]
    for index in rng.choice(trains, VIEWS // 5, replace=False):
        along = rng.uniform(0, np.pi)
        reach = np.arange(-14, 15)
        x, y = np.meshgrid(reach, reach)
        one = np.exp(-0.5 * ((x * np.cos(along) + y * np.sin(along)) / sigma) ** 2)
        one *= np.exp(-0.5 * ((y * np.cos(along) - x * np.sin(along)) / max(0.2, 0.3 * sigma)) ** 2)
        light = cv2.filter2D(linear_from_srgb(images[index]), -1, one / one.sum(), borderType=cv2.BORDER_REFLECT)
        images[index] = srgb_from_linear(light)
    return images, points


PutIn = Callable[[SyntheticScene, SparsePoints, float, np.random.Generator], tuple[Images, SparsePoints]]
PUT_IN: dict[str, PutIn] = {
    "exposure": vary_exposure,
    "view-dependence": add_sheen,
    "transients": let_walk,
    "blur": blur_some,
}


def _encode(linear: NDArray[np.floating]) -> Images:
    return np.clip(srgb_from_linear(linear), 0, 1).astype(np.float32)


def _drop(points: SparsePoints, lost: NDArray[np.bool_]) -> SparsePoints:
    """Points without some of their matches."""
    kept = ~lost
    lengths = np.bincount(points.track_point[kept], minlength=len(points))
    return replace(
        points,
        track_offsets=np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
        track_frame=points.track_frame[kept],
        track_xy=points.track_xy[kept],
    )
