"""Made-up rooms as Mitsuba scenes: metres, z up, the room's middle at (0, 0). No two of a seed's rooms are alike."""

from dataclasses import dataclass

import mitsuba as mi
import numpy as np
import patterns
import scene as shapes
from scene import T, box, ellipsoid, lathe, matte, metal, panel, rounded, varnished

Parts = dict
Generator = np.random.Generator


@dataclass(frozen=True)
class Room:
    """half: half of its width and depth; places: where furniture stands, (x, y, height of its top)."""

    scene: mi.Scene
    half: tuple[float, float]
    places: list[tuple[float, float, float]]


def build(rng: Generator) -> Room:
    """A room: walls, lights, two to six pieces of furniture with things on them, pictures on the walls."""
    half, height = (rng.uniform(1.5, 2.6), rng.uniform(1.5, 2.6)), rng.uniform(2.2, 3.0)
    parts = _shell(rng, half, height) | _lights(rng, half, height)
    places = []
    for i, (x, y) in enumerate(_spots(rng, half)):
        piece, top = _furniture(rng, x, y)
        parts |= {f"piece{i}_{name}": part for name, part in piece.items()}
        parts |= {f"thing{i}_{name}": part for name, part in _things(rng, x, y, top).items()}
        places.append((x, y, top))
    return Room(mi.load_dict({"type": "scene", **parts}), half, places)


def surface_of(rng: Generator, choice: tuple[patterns.Pattern, ...]) -> mi.BSDF:
    """Matte or varnished, in a pattern; now and then of metal where anything may be."""
    if choice is patterns.THINGS and rng.random() < 0.08:
        return metal(str(rng.choice(["Ag", "Au", "Cu", "Al"])), rng.uniform(0.05, 0.4))
    reflectance = shapes._texture(patterns.any_of(choice, rng))
    return matte(reflectance) if rng.random() < 0.5 else varnished(reflectance, rng.uniform(0.08, 0.4))


def _shell(rng: Generator, half: tuple[float, float], height: float) -> Parts:
    """Six planes, each wall either like the first or of its own."""
    (hx, hy), common = half, surface_of(rng, patterns.WALLS)
    up, at, about_z = T().rotate([1, 0, 0], 90), T().translate, lambda turn: T().rotate([0, 0, 1], turn)
    walls = {"north": (0, hy, 0, hx), "west": (-hx, 0, 90, hy), "south": (0, -hy, 180, hx), "east": (hx, 0, 270, hy)}
    parts = {
        name: panel(
            at([x, y, height / 2]) @ about_z(turn) @ up,
            wide,
            height / 2,
            bsdf=common if rng.random() < 0.6 else surface_of(rng, patterns.WALLS),
        )
        for name, (x, y, turn, wide) in walls.items()
    }
    parts["floor"] = panel(T(), hx, hy, bsdf=surface_of(rng, patterns.FLOORS))
    parts["ceiling"] = panel(at([0, 0, height]) @ T().rotate([1, 0, 0], 180), hx, hy, bsdf=_pale(rng))
    for i, (x, y, turn, wide) in enumerate(walls.values()):
        for k in range(int(rng.integers(0, 4))):
            across, up_by = rng.uniform(-0.8, 0.8) * wide, rng.uniform(1.0, height - 0.4)
            inward = at([x, y, 0]) @ about_z(turn) @ at([across, -0.01 - 0.004 * k, up_by]) @ up
            parts[f"art{i}_{k}"] = panel(
                inward, rng.uniform(0.12, 0.5), rng.uniform(0.12, 0.4), bsdf=matte(_texture_of(rng, patterns.picture))
            )
    if rng.random() < 0.6:
        x, y = (rng.uniform(-0.3, 0.3) * h for h in half)
        wide, deep = rng.uniform(0.4, 0.8) * hx, rng.uniform(0.4, 0.8) * hy
        parts["rug"] = box(
            (x - wide, y - deep, 0), (x + wide, y + deep, 0.012), matte(_texture_of(rng, patterns.checks)),
            rng.uniform(-30, 30),
        )  # fmt: skip
    return parts


def _texture_of(rng: Generator, pattern: patterns.Pattern) -> dict:
    return shapes._texture(pattern(rng, 384, 512))


def _pale(rng: Generator) -> mi.BSDF:
    return matte(shapes._colour(*map(float, rng.uniform(0.8, 0.95, 3))))


def _lights(rng: Generator, half: tuple[float, float], height: float) -> Parts:
    """One or two panels below the ceiling and perhaps a window, warm to cold: together about as bright in any room."""
    parts, count = {}, int(rng.integers(1, 3))
    for i in range(count):
        x, y = (rng.uniform(-0.5, 0.5) * h for h in half)
        side = rng.uniform(0.4, 1.0)
        place = T().translate([x, y, height - 0.01 - 0.01 * i]) @ T().rotate([1, 0, 0], 180)
        power = rng.uniform(2.0, 4.5) * half[0] * half[1] / (4 * side * side * count)
        parts[f"lamp{i}"] = panel(place, side, side, emitter=_warmth(rng, power))
    if rng.random() < 0.6:
        turn, reach = rng.choice([90, 270]), half[0] - 0.01
        place = T().rotate([0, 0, 1], float(turn)) @ T().translate([0, reach, 1.4]) @ T().rotate([1, 0, 0], 90)
        parts["window"] = panel(place, rng.uniform(0.4, 0.9), rng.uniform(0.4, 0.7), emitter=_warmth(rng, 4.0))
    return parts


def _warmth(rng: Generator, power: float) -> dict:
    tint = rng.uniform(-0.25, 0.25)
    return shapes._area(power * (1 + tint), power, power * (1 - tint))


def _spots(rng: Generator, half: tuple[float, float]) -> list[tuple[float, float]]:
    """Two to six places, 0.9 m apart, as far as they fit."""
    spots: list[tuple[float, float]] = []
    wanted = int(rng.integers(2, 7))
    for _ in range(40):
        x, y = (float(rng.uniform(0.45 - h, h - 0.45)) for h in half)
        if len(spots) < wanted and all(np.hypot(x - a, y - b) > 0.9 for a, b in spots):
            spots.append((x, y))
    return spots


def _furniture(rng: Generator, x: float, y: float) -> tuple[Parts, float]:
    """A chest, a table or an armchair's block with its back, and the height of its top."""
    wide, deep, turn = rng.uniform(0.22, 0.42), rng.uniform(0.2, 0.4), float(rng.uniform(0, 90))
    body, top = surface_of(rng, patterns.THINGS), float(rng.uniform(0.35, 0.95))
    if rng.random() < 0.4:
        return {"chest": box((x - wide, y - deep, 0), (x + wide, y + deep, top), body, turn)}, top
    if rng.random() < 0.5:
        leg = lathe([(0.0, 0.0), (0.16, 0.0), (0.05, 0.08), (0.05, top - 0.03), (0.0, top - 0.03)], (x, y, 0), body)
        board = box((x - wide, y - deep, top - 0.03), (x + wide, y + deep, top), surface_of(rng, patterns.THINGS), turn)
        return {"leg": leg, "board": board}, top
    top = min(top, 0.5)
    along = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))]) * wide
    back = box(
        (x + along[0] - 0.05, y + along[1] - deep, 0), (x + along[0] + 0.05, y + along[1] + deep, top + 0.4), body, turn
    )
    return {"seat": box((x - wide, y - deep, 0), (x + wide, y + deep, top), body, turn), "back": back}, top


def _things(rng: Generator, x: float, y: float, top: float) -> Parts:
    """Up to five vases, balls, boxes and pebbles on a piece of furniture."""
    parts: Parts = {}
    for i in range(int(rng.integers(1, 6))):
        at = (x + rng.uniform(-0.17, 0.17), y + rng.uniform(-0.15, 0.15), top)
        look, size = surface_of(rng, patterns.THINGS), float(rng.uniform(0.04, 0.12))
        kind = rng.integers(4)
        if kind == 0:
            radii = np.concatenate([[0.0], size * rng.uniform(0.3, 1.0, 4), [0.0]])
            heights = np.concatenate([[0.0], np.sort(rng.uniform(0, 4 * size, 4)), [4 * size]])
            parts[f"vase{i}"] = lathe(rounded(list(zip(radii, heights, strict=True))), at, look)
        elif kind == 1:
            parts[f"ball{i}"] = {
                "type": "sphere", "center": [at[0], at[1], top + size], "radius": size, "bsdf": look,
            }  # fmt: skip
        elif kind == 2:
            reach = np.array([size, 0.7 * size, 0.0])
            low, high = at - reach, at + reach
            high[2] += rng.uniform(0.4, 4) * size
            parts[f"block{i}"] = box(tuple(low), tuple(high), look, float(rng.uniform(0, 90)))
        else:
            axes = np.diag(size * rng.uniform(0.4, 1.2, 3))
            parts[f"pebble{i}"] = ellipsoid((at[0], at[1], top + axes[2, 2]), axes, look, n=24)
    return parts
