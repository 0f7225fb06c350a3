"""The demo room as a Mitsuba scene: metres, z up, the object at (0, 0, TABLE_TOP) on a table.

The corner of the room lies behind the object (walls at y = 1.6 and x = -1.8); cameras stand on the other side. Light
comes from a ceiling panel and a window, both large, so that little noise is left after a few dozen samples.
"""

from collections.abc import Callable

import mitsuba as mi
import numpy as np
import textures as tx

TABLE_TOP = 0.52
WEST, EAST, SOUTH, NORTH, CEILING = -1.8, 2.7, -2.8, 1.6, 2.6

T = mi.ScalarTransform4f
Transform = mi.ScalarTransform4f


def _linear(srgb: np.ndarray) -> np.ndarray:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _texture(picture: np.ndarray) -> dict:
    bitmap = mi.Bitmap(np.ascontiguousarray(_linear(picture)))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "mirror"}


def _colour(r: float, g: float, b: float) -> dict:
    return {"type": "rgb", "value": [float(c) for c in _linear(np.array([r, g, b]))]}


def _twosided(bsdf: dict) -> mi.BSDF:
    return mi.load_dict({"type": "twosided", "bsdf": bsdf})


def matte(reflectance: dict) -> mi.BSDF:
    return _twosided({"type": "diffuse", "reflectance": reflectance})


def varnished(reflectance: dict, roughness: float) -> mi.BSDF:
    return _twosided(
        {"type": "roughplastic", "diffuse_reflectance": reflectance, "alpha": roughness, "distribution": "ggx"}
    )


def metal(name: str, roughness: float) -> mi.BSDF:
    return _twosided({"type": "roughconductor", "material": name, "alpha": roughness, "distribution": "ggx"})


def box(low: tuple[float, float, float], high: tuple[float, float, float], bsdf: mi.BSDF, turn: float = 0.0) -> dict:
    """An axis-aligned box between two corners, turned by `turn` degrees about the vertical through its middle."""
    middle, half = (np.array(low) + high) / 2, (np.array(high) - low) / 2
    place = T().translate(middle.tolist()).rotate([0, 0, 1], turn).scale(half.tolist())
    return {"type": "cube", "to_world": place, "bsdf": bsdf}


def panel(place: Transform, half_x: float, half_y: float, **extra: dict) -> dict:
    return {"type": "rectangle", "to_world": place @ T().scale([half_x, half_y, 1]), **extra}


def surface(
    point: Callable[[np.ndarray, np.ndarray], np.ndarray], bsdf: mi.BSDF, nu: int = 96, nv: int = 48
) -> mi.Mesh:
    """A mesh of point(u, v) over the unit square, u and v [nv, nu]; outward is d/du x d/dv."""
    u, v = np.meshgrid(np.linspace(0, 1, nu), np.linspace(0, 1, nv))
    vertices = point(u, v).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(nv - 1)[:, None] * nu + np.arange(nu - 1)[None]).reshape(-1)
    lower = np.stack([corner, corner + 1, corner + nu + 1], -1)
    upper = np.stack([corner, corner + nu + 1, corner + nu], -1)
    faces = np.concatenate([lower, upper]).astype(np.uint32)
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    mesh = mi.Mesh(
        "surface", len(vertices), len(faces), props=properties, has_vertex_normals=True, has_vertex_texcoords=True
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["vertex_texcoords"] = np.stack([u, v], -1).reshape(-1, 2).astype(np.float32).ravel()
    parameters["faces"] = faces.ravel()
    parameters.update()
    mesh.recompute_vertex_normals()
    return mesh


def lathe(profile: list[tuple[float, float]], at: tuple[float, float, float], bsdf: mi.BSDF, nv: int = 64) -> mi.Mesh:
    """Turn a profile of (radius, height) points, smoothed by a monotone resampling, about the vertical through `at`."""
    knots = np.array(profile, float)
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(knots, axis=0).T))])

    def point(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        radius, height = (np.interp(v * along[-1], along, knots[:, axis]) for axis in (0, 1))
        angle = 2 * np.pi * u
        return np.stack([at[0] + radius * np.cos(angle), at[1] + radius * np.sin(angle), at[2] + height], -1)

    return surface(point, bsdf, nv=nv)


def rounded(profile: list[tuple[float, float]], n: int = 48) -> list[tuple[float, float]]:
    """Chaikin's corner cutting, three rounds: a smooth profile from a few points."""
    points = np.array(profile, float)
    for _ in range(3):
        a, b = 0.75 * points[:-1] + 0.25 * points[1:], 0.25 * points[:-1] + 0.75 * points[1:]
        points = np.concatenate([points[:1], np.stack([a, b], 1).reshape(-1, 2), points[-1:]])
    keep = np.linspace(0, len(points) - 1, n).astype(int)
    return [tuple(p) for p in points[keep]]


def ellipsoid(centre: tuple[float, float, float], axes: np.ndarray, bsdf: mi.BSDF, n: int = 40) -> mi.Mesh:
    """centre + axes @ (unit sphere); axes [3, 3] has the half axes as columns."""

    def point(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        angle, tilt = 2 * np.pi * u, np.pi * (v - 0.5)
        unit = np.stack([np.cos(angle) * np.cos(tilt), np.sin(angle) * np.cos(tilt), np.sin(tilt)], -1)
        return np.array(centre) + unit @ np.asarray(axes).T

    return surface(point, bsdf, nu=2 * n, nv=n)


def tube(path: np.ndarray, radius: np.ndarray, bsdf: mi.BSDF) -> mi.Mesh:
    """A round tube along path [n, 3] with its radius [n]; `path` must not run along (0.3, 1, 0.2)."""
    tangent = np.gradient(path, axis=0)
    side = np.cross(tangent, [0.3, 1.0, 0.2])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    other = np.cross(tangent, side)
    other /= np.linalg.norm(other, axis=-1, keepdims=True)

    def point(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        at = np.round(v * (len(path) - 1)).astype(int)
        angle = 2 * np.pi * u[..., None]
        return path[at] + radius[at][..., None] * (np.cos(angle) * side[at] + np.sin(angle) * other[at])

    return surface(point, bsdf, nu=24, nv=len(path))


def _shell(rng: np.random.Generator) -> dict:
    depth, width = (NORTH - SOUTH) / 2, (EAST - WEST) / 2
    middle_x, middle_y, middle_z = (EAST + WEST) / 2, (NORTH + SOUTH) / 2, CEILING / 2
    paper, brick = matte(_texture(tx.botanical_wallpaper(rng))), matte(_texture(tx.bricks(rng)))
    floor = varnished(_texture(tx.planks(rng)), 0.25)
    up, south, east = T().rotate([1, 0, 0], 90), T().rotate([1, 0, 0], -90), T().rotate([0, 1, 0], -90)
    at = T().translate
    return {
        "floor": panel(at([middle_x, middle_y, 0]), width, depth, bsdf=floor),
        "ceiling": panel(
            at([middle_x, middle_y, CEILING]) @ T().rotate([1, 0, 0], 180),
            width,
            depth,
            bsdf=matte(_colour(0.93, 0.92, 0.90)),
        ),
        "north": panel(at([middle_x, NORTH, middle_z]) @ up, width, CEILING / 2, bsdf=paper),
        "south": panel(at([middle_x, SOUTH, middle_z]) @ south, width, CEILING / 2, bsdf=paper),
        "west": panel(at([WEST, middle_y, middle_z]) @ T().rotate([0, 0, 1], 90) @ up, depth, CEILING / 2, bsdf=brick),
        "east": panel(at([EAST, middle_y, middle_z]) @ east, CEILING / 2, depth, bsdf=matte(_colour(0.86, 0.80, 0.70))),
        "lamp": panel(
            at([0.4, -0.5, CEILING - 0.01]) @ T().rotate([1, 0, 0], 180), 1.0, 1.0, emitter=_area(3.6, 3.2, 2.7)
        ),
        "window": panel(at([EAST - 0.01, -0.9, 1.45]) @ east, 0.75, 0.95, emitter=_area(4.6, 4.7, 4.8)),
        "skirting": box((WEST, NORTH - 0.02, 0), (EAST, NORTH, 0.09), matte(_colour(0.90, 0.88, 0.84))),
        "skirting_west": box((WEST, SOUTH, 0), (WEST + 0.02, NORTH, 0.09), matte(_colour(0.90, 0.88, 0.84))),
        "rug": box((-1.15, -1.35, 0), (1.35, 0.75, 0.012), matte(_texture(tx.rug(rng))), turn=-8),
    }


def _area(r: float, g: float, b: float) -> dict:
    return {"type": "area", "radiance": {"type": "rgb", "value": [r, g, b]}}


def _table(rng: np.random.Generator) -> dict:
    top = varnished(_texture(tx.wood(rng, 768, 1152, (0.66, 0.45, 0.27), 11)), 0.15)
    leg = varnished(_texture(tx.wood(rng, 128, 512, (0.48, 0.31, 0.19))), 0.2)
    parts = {"table_top": box((-0.62, -0.42, TABLE_TOP - 0.035), (0.62, 0.42, TABLE_TOP), top)}
    for i, (x, y) in enumerate([(-0.56, -0.36), (0.56, -0.36), (-0.56, 0.36), (0.56, 0.36)]):
        parts[f"table_leg{i}"] = box((x - 0.03, y - 0.03, 0), (x + 0.03, y + 0.03, TABLE_TOP - 0.035), leg)
    z = TABLE_TOP
    for i, (half, thick, turn) in enumerate(
        [((0.13, 0.09), 0.03, 20), ((0.115, 0.085), 0.022, 33), ((0.1, 0.07), 0.026, 8)]
    ):
        cover = varnished(_texture(tx.poster(rng, 1 + i % 3)), 0.3)
        parts[f"table_book{i}"] = box(
            (-0.42 - half[0], 0.16 - half[1], z), (-0.42 + half[0], 0.16 + half[1], z + thick), cover, turn
        )
        z += thick
    parts["ball"] = {
        "type": "sphere",
        "center": [0.40, 0.20, TABLE_TOP + 0.085],
        "radius": 0.085,
        "bsdf": metal("Ag", 0.04),
    }
    parts["runner"] = box(
        (-0.30, -0.30, TABLE_TOP), (0.34, 0.30, TABLE_TOP + 0.003), matte(_texture(tx.rug(rng, 640, 800))), 12
    )
    mug = [(0.0, 0.0), (0.036, 0.0), (0.040, 0.01), (0.040, 0.09), (0.036, 0.09), (0.034, 0.01), (0.0, 0.008)]
    parts["mug"] = lathe(mug, (-0.44, -0.22, TABLE_TOP), varnished(_colour(0.78, 0.40, 0.22), 0.1))
    return parts


def _sideboard(rng: np.random.Generator) -> dict:
    body = varnished(_texture(tx.wood(rng, 512, 1024, (0.52, 0.33, 0.20), 8)), 0.2)
    door = varnished(_texture(tx.wood(rng, 512, 512, (0.62, 0.42, 0.26), 14)), 0.2)
    front, top = NORTH - 0.42, 0.78
    parts = {"sideboard": box((-0.75, front, 0.1), (0.95, NORTH - 0.02, top), body)}
    for i in range(3):
        x = -0.72 + 0.555 * i
        parts[f"door{i}"] = box((x, front - 0.018, 0.14), (x + 0.53, front, top - 0.04), door)
        knob = [x + (0.47 if i == 0 else 0.06), front - 0.035, 0.5]
        parts[f"knob{i}"] = {"type": "sphere", "center": knob, "radius": 0.02, "bsdf": metal("Au", 0.15)}
    pot = rounded([(0.0, 0.0), (0.09, 0.0), (0.15, 0.06), (0.14, 0.15), (0.06, 0.2), (0.05, 0.21), (0.0, 0.26)])
    at, copper = (0.42, NORTH - 0.22, top), metal("Cu", 0.08)
    parts["teapot"] = lathe(pot, at, copper)
    t = np.linspace(0, 1, 24)
    spout = np.stack([at[0] - 0.12 - 0.13 * t, at[1] + 0 * t, at[2] + 0.08 + 0.13 * t**1.5], -1)
    turn = np.linspace(-1.4, 1.4, 32)
    grip = np.stack([at[0] + 0.12 + 0.09 * np.cos(turn), at[1] + 0 * turn, at[2] + 0.11 + 0.08 * np.sin(turn)], -1)
    parts["spout"] = tube(spout, 0.032 - 0.018 * t, copper)
    parts["grip"] = tube(grip, np.full(32, 0.012), copper)
    vase = rounded([(0.0, 0.0), (0.06, 0.0), (0.10, 0.12), (0.07, 0.26), (0.035, 0.32), (0.06, 0.36), (0.05, 0.36)])
    parts["vase"] = lathe(vase, (-0.50, NORTH - 0.22, top), varnished(_texture(tx.poster(rng, 2, 512, 800)), 0.05))
    parts["mirror"] = panel(
        T().translate([0.05, NORTH - 0.03, 1.55]) @ T().rotate([1, 0, 0], 90), 0.36, 0.48, bsdf=metal("Al", 0.01)
    )
    frame = varnished(_texture(tx.wood(rng, 256, 256, (0.70, 0.52, 0.26))), 0.15)
    parts["mirror_frame"] = box((-0.36, NORTH - 0.028, 1.02), (0.46, NORTH - 0.002, 2.08), frame)
    return parts


def _pictures(rng: np.random.Generator) -> dict:
    parts: dict = {}
    frame = varnished(_colour(0.20, 0.14, 0.10), 0.2)
    north = [
        (-1.30, 1.55, 0.27, 0.36),
        (-0.72, 1.72, 0.20, 0.26),
        (0.88, 1.62, 0.24, 0.32),
        (1.52, 1.42, 0.28, 0.38),
        (2.2, 1.6, 0.25, 0.32),
    ]
    for i, (x, z, half_x, half_z) in enumerate(north):
        art = matte(_texture(tx.poster(rng, i % 4)))
        parts[f"north_frame{i}"] = box(
            (x - half_x - 0.02, NORTH - 0.024, z - half_z - 0.02),
            (x + half_x + 0.02, NORTH - 0.001, z + half_z + 0.02),
            frame,
        )
        parts[f"north_art{i}"] = panel(
            T().translate([x, NORTH - 0.026, z]) @ T().rotate([1, 0, 0], 90), half_x, half_z, bsdf=art
        )
    west = [(-0.75, 1.5, 0.36, 0.46), (-1.55, 1.62, 0.26, 0.34), (-2.3, 1.5, 0.28, 0.36)]
    for i, (y, z, half_y, half_z) in enumerate(west):
        art = matte(_texture(tx.poster(rng, (i + 1) % 4)))
        place = T().translate([WEST + 0.026, y, z]) @ T().rotate([0, 0, 1], 90) @ T().rotate([1, 0, 0], 90)
        parts[f"west_frame{i}"] = box(
            (WEST + 0.001, y - half_y - 0.02, z - half_z - 0.02),
            (WEST + 0.024, y + half_y + 0.02, z + half_z + 0.02),
            frame,
        )
        parts[f"west_art{i}"] = panel(place, half_y, half_z, bsdf=art)
    return parts


def _bookshelf(rng: np.random.Generator) -> dict:
    board = varnished(_texture(tx.wood(rng, 256, 1024, (0.56, 0.38, 0.23))), 0.25)
    y0, y1, depth, height = -0.12, 1.08, 0.28, 2.0
    parts = {
        f"shelf_side{i}": box((WEST, y, 0), (WEST + depth, y + 0.025, height), board)
        for i, y in enumerate((y0, y1 - 0.025))
    }
    spines = [varnished(_texture(tx.book_spine(rng)), 0.3) for _ in range(24)]
    for level in range(6):
        z = 0.06 + level * (height - 0.09) / 5
        parts[f"shelf{level}"] = box((WEST, y0, z), (WEST + depth, y1, z + 0.025), board)
        y = y0 + 0.04
        while level < 5 and y < y1 - 0.12:
            thick, tall, deep = rng.uniform(0.022, 0.055), rng.uniform(0.2, 0.32), rng.uniform(0.17, 0.23)
            if rng.random() > 0.08:
                book = box(
                    (WEST + 0.02, y, z + 0.025),
                    (WEST + 0.02 + deep, y + thick, z + 0.025 + tall),
                    spines[rng.integers(24)],
                )
                parts[f"book{level}_{len(parts)}"] = book
            y += thick + 0.002
    return parts


def _chair_and_plant(rng: np.random.Generator) -> dict:
    timber = varnished(_texture(tx.wood(rng, 128, 512, (0.58, 0.40, 0.24))), 0.2)
    cushion = matte(_texture(tx.poster(rng, 1, 512, 512)))
    x, y = 1.45, 0.95
    parts = {
        "seat": box((x - 0.22, y - 0.22, 0.43), (x + 0.22, y + 0.22, 0.46), timber),
        "cushion": box((x - 0.2, y - 0.2, 0.46), (x + 0.2, y + 0.2, 0.51), cushion),
    }
    for i, (dx, dy, top) in enumerate([(-0.2, -0.2, 0.43), (0.2, -0.2, 0.43), (-0.2, 0.2, 0.95), (0.2, 0.2, 0.95)]):
        parts[f"chair_leg{i}"] = box((x + dx - 0.02, y + dy - 0.02, 0), (x + dx + 0.02, y + dy + 0.02, top), timber)
    for i, z in enumerate((0.60, 0.72, 0.84)):
        parts[f"chair_back{i}"] = box((x - 0.2, y + 0.19, z), (x + 0.2, y + 0.21, z + 0.08), timber)
    pot = rounded([(0.0, 0.0), (0.13, 0.0), (0.17, 0.14), (0.19, 0.30), (0.17, 0.30), (0.15, 0.26), (0.0, 0.25)])
    at = (-1.32, 1.30, 0.0)
    parts["pot"] = lathe(pot, at, varnished(_texture(tx.bricks(rng, 256, 512, 6, 12)), 0.15))
    greens = [matte(_colour(*c)) for c in ((0.22, 0.36, 0.16), (0.30, 0.44, 0.20), (0.38, 0.48, 0.22))]
    for i in range(34):
        angle, lift, length = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 1.4), rng.uniform(0.10, 0.19)
        along = np.array([np.cos(angle) * np.cos(lift), np.sin(angle) * np.cos(lift), np.sin(lift)])
        side = np.array([-np.sin(angle), np.cos(angle), 0.0])
        stem = np.array([at[0], at[1], 0.3 + rng.uniform(0, 0.35)])
        axes = np.stack([along * length, side * length * 0.28, np.cross(along, side) * 0.006], -1)
        parts[f"leaf{i}"] = ellipsoid(tuple(stem + along * length), axes, greens[i % 3], n=14)
    return parts


def figure(rng: np.random.Generator) -> dict:
    """The object to be removed: a glazed figure, 0.40 m tall: plinth, body, head, hat, two arms with hands."""
    skin = varnished(_texture(tx.glaze(rng)), 0.12)
    hat = varnished(_texture(tx.glaze(rng, 256, 512)), 0.12)
    base = TABLE_TOP + 0.003
    body = rounded([(0.0, 0.02), (0.085, 0.02), (0.105, 0.07), (0.10, 0.14), (0.06, 0.22), (0.03, 0.245), (0.0, 0.25)])
    plinth = [(0.0, 0.0), (0.098, 0.0), (0.098, 0.022), (0.09, 0.03), (0.0, 0.03)]
    brim = [(0.0, 0.315), (0.078, 0.315), (0.078, 0.325), (0.04, 0.335), (0.028, 0.395), (0.0, 0.40)]
    parts = {
        "plinth": lathe(plinth, (0, 0, base), hat),
        "body": lathe(body, (0, 0, base), skin),
        "hat": lathe(brim, (0, 0, base), hat),
    }
    parts["head"] = ellipsoid((0, 0, base + 0.285), np.diag([0.052, 0.052, 0.055]), skin)
    for i, side in enumerate((-1, 1)):
        t = np.linspace(0, 1, 24)
        arm = np.stack([side * (0.06 + 0.07 * np.sin(np.pi * t * 0.9)), -0.06 * t, base + 0.205 - 0.11 * t], -1)
        parts[f"arm{i}"] = tube(arm, np.full(24, 0.021), hat)
        parts[f"hand{i}"] = ellipsoid(tuple(arm[-1]), np.diag([0.027, 0.027, 0.027]), skin)
    return parts


def _assemble(parts: dict) -> mi.Scene:
    return mi.load_dict({"type": "scene", **parts})


def build(seed: int) -> dict[str, mi.Scene]:
    """Three scenes that share every surface: `with` the object, `without` it, and the `object` alone (for masks)."""
    rngs = [np.random.default_rng([seed, i]) for i in range(7)]
    makers = (_shell, _table, _sideboard, _pictures, _bookshelf, _chair_and_plant)
    room = {name: part for make, rng in zip(makers, rngs, strict=False) for name, part in make(rng).items()}
    thing = figure(rngs[6])
    return {"with": _assemble(room | thing), "without": _assemble(room), "object": _assemble(thing)}
