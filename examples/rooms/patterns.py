"""Pictures for the surfaces of made-up rooms: patterns and colours that the demo room has none of.

Every function returns float32 [h, w, 3], sRGB-encoded in [0, 1]. Only noise and the grain of wood come from the demo's
textures: what the demo's walls, rug and figure show must not be learnt here.
"""

import colorsys
from collections.abc import Callable

import numpy as np
import textures as tx

Picture = np.ndarray
Generator = np.random.Generator
Pattern = Callable[[Generator, int, int], Picture]


def colour(rng: Generator, most_saturated: float = 0.7) -> np.ndarray:
    """Any hue, rather pale than vivid."""
    value, saturation = rng.uniform(0.25, 0.95), most_saturated * rng.beta(1.2, 2.0)
    return np.array(colorsys.hsv_to_rgb(rng.random(), saturation, value), np.float32)


def _grid(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:height, :width].astype(np.float32)
    return y / height, x / height


def _blend(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> Picture:
    return (first * (1 - share[..., None]) + second * share[..., None]).astype(np.float32)


def _worn(picture: Picture, rng: Generator, strength: float) -> Picture:
    """Stains and grain, so that no surface is one flat colour."""
    height, width = picture.shape[:2]
    noise = tx.fractal_noise(rng, height, width, 6, 6 * width / height, 6) - 0.5
    return np.clip(picture * (1 + strength * noise[..., None]), 0, 1).astype(np.float32)


def plaster(rng: Generator, height: int, width: int) -> Picture:
    """One colour of paint on a rough wall."""
    return _worn(np.tile(colour(rng, 0.5), (height, width, 1)), rng, rng.uniform(0.1, 0.5))


def stripes(rng: Generator, height: int, width: int) -> Picture:
    """Upright or slanted stripes of two or three widths."""
    y, x = _grid(height, width)
    turn = rng.choice([0.0, 0.0, rng.uniform(-1, 1)])
    phase = (x + turn * y) * rng.uniform(4, 18)
    sharp = rng.uniform(4, 40)
    share = 1 / (1 + np.exp(-sharp * (np.sin(2 * np.pi * phase) + rng.uniform(-0.6, 0.6))))
    return _worn(_blend(colour(rng), colour(rng), share), rng, 0.15)


def checks(rng: Generator, height: int, width: int) -> Picture:
    """Cloth of crossing bands, as a kilt has."""
    y, x = _grid(height, width)
    bands = [sum(rng.uniform(0.2, 1) * (np.sin(rng.uniform(10, 90) * a) > rng.uniform(0, 0.9)) for _ in range(3))
             for a in (x, y)]  # fmt: skip
    share = np.clip((bands[0] + bands[1]) / 3, 0, 1).astype(np.float32)
    return _worn(_blend(colour(rng), colour(rng), share), rng, 0.2)


def tiles(rng: Generator, height: int, width: int) -> Picture:
    """Square or oblong tiles with grout, each a little off the common colour."""
    y, x = _grid(height, width)
    rows, ratio = rng.integers(4, 14), rng.choice([0.5, 1.0, 1.0, 2.0])
    v, u = y * rows, x * rows * ratio
    cell_v, cell_u = v.astype(int), u.astype(int)
    tones = rng.normal(0, rng.uniform(0.01, 0.12), (cell_v.max() + 1, cell_u.max() + 1, 3))
    edge = np.minimum(np.minimum(v % 1, 1 - v % 1), np.minimum(u % 1, 1 - u % 1) / ratio)
    face = np.clip(colour(rng) + tones[cell_v, cell_u], 0.02, 0.98)
    return _worn(_blend(colour(rng, 0.2), face, np.clip(edge / rng.uniform(0.02, 0.06), 0, 1)), rng, 0.2)


def terrazzo(rng: Generator, height: int, width: int) -> Picture:
    """Chips of stone in cement: cells about random points, some of them coloured."""
    y, x = _grid(height, width)
    count = int(rng.integers(120, 400))
    places = rng.random((count, 2)).astype(np.float32) * [1, width / height]
    owner, nearest, second = (
        np.zeros((height, width), int),
        np.full((height, width), 9.0),
        np.full((height, width), 9.0),
    )
    for i, (py, px) in enumerate(places):
        away = np.hypot(y - py, x - px)
        closer = away < nearest
        second = np.where(closer, nearest, np.minimum(second, away))
        owner, nearest = np.where(closer, i, owner), np.where(closer, away, nearest)
    palette = np.stack([colour(rng) for _ in range(int(rng.integers(2, 6)))])
    chips = palette[rng.integers(len(palette), size=count)][owner]
    inside = np.clip((second - nearest - rng.uniform(0.005, 0.03)) * 80, 0, 1).astype(np.float32)
    return _worn(_blend(colour(rng, 0.2), chips, inside), rng, 0.2)


def marble(rng: Generator, height: int, width: int) -> Picture:
    """Veins: a sine wave bent by noise."""
    y, x = _grid(height, width)
    bend = tx.fractal_noise(rng, height, width, 3, 3 * width / height, 7)
    vein = np.abs(np.sin(rng.uniform(3, 12) * (x + y * rng.uniform(-1, 1)) + rng.uniform(4, 14) * bend))
    return _worn(_blend(colour(rng), colour(rng, 0.4), vein ** rng.uniform(0.3, 1.2)), rng, 0.15)


def weave(rng: Generator, height: int, width: int) -> Picture:
    """Coarse threads over and under each other."""
    y, x = _grid(height, width)
    count = rng.uniform(40, 90)
    over = (np.floor(y * count) + np.floor(x * count)) % 2
    thread = np.where(over > 0, np.abs(np.sin(np.pi * y * count)), np.abs(np.sin(np.pi * x * count)))
    return _worn(_blend(colour(rng), colour(rng), over) * (0.6 + 0.4 * thread[..., None]), rng, 0.4)


def boards(rng: Generator, height: int, width: int) -> Picture:
    """Wood of any stain."""
    stain = colour(rng, 0.6)
    return tx.wood(rng, height, width, tuple(map(float, stain)), rings=rng.uniform(4, 14))


def picture(rng: Generator, height: int, width: int) -> Picture:
    """What hangs on a wall: bands of a landscape under a sky, or a heap of boxes and rings."""
    y, x = _grid(height, width)
    image = _blend(colour(rng), colour(rng), y)
    if rng.random() < 0.5:
        for level in np.sort(rng.uniform(0.2, 0.95, int(rng.integers(2, 7)))):
            line = level + 0.3 * (tx.fractal_noise(rng, 1, width, 1, rng.uniform(2, 9), 5)[0] - 0.5)
            image = np.where((y > line)[..., None], colour(rng), image)
    else:
        for _ in range(int(rng.integers(5, 40))):
            cy, cx = rng.random(), rng.random() * width / height
            size, turn = rng.uniform(0.03, 0.3), rng.uniform(0, np.pi)
            u = np.cos(turn) * (x - cx) + np.sin(turn) * (y - cy)
            v = -np.sin(turn) * (x - cx) + np.cos(turn) * (y - cy)
            ring, bar = np.abs(np.hypot(u, v) - size) < 0.25 * size, (np.abs(u) < size) & (np.abs(v) < 0.3 * size)
            image = np.where((ring if rng.random() < 0.5 else bar)[..., None], colour(rng), image)
    return _worn(image, rng, 0.2)


WALLS: tuple[Pattern, ...] = (plaster, plaster, stripes, checks, tiles, marble, weave, boards)
FLOORS: tuple[Pattern, ...] = (boards, tiles, terrazzo, marble, weave)
THINGS: tuple[Pattern, ...] = (plaster, stripes, checks, tiles, terrazzo, marble, weave, boards, picture)


def any_of(patterns: tuple[Pattern, ...], rng: Generator, height: int = 384, width: int = 512) -> Picture:
    """A pattern, drawn."""
    return patterns[rng.integers(len(patterns))](rng, height, width)
