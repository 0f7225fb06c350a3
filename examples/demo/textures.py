"""Pictures for the surfaces of the demo room, synthesised from a seed.

Every function returns float32 [h, w, 3], sRGB-encoded in [0, 1]. Patterns are made not to repeat (each motif has its
own place, size and colour): a strictly periodic wallpaper would match itself everywhere and mislead feature matching.
"""

import numpy as np

Picture = np.ndarray
Generator = np.random.Generator


def _smooth(t: np.ndarray) -> np.ndarray:
    return t * t * (3.0 - 2.0 * t)


def value_noise(rng: Generator, height: int, width: int, cells_y: float, cells_x: float) -> np.ndarray:
    """Smoothly interpolated random lattice in [0, 1], float32 [height, width]."""
    lattice = rng.random((int(cells_y) + 2, int(cells_x) + 2), dtype=np.float32)
    y, x = np.linspace(0, cells_y, height, endpoint=False), np.linspace(0, cells_x, width, endpoint=False)
    y0, x0 = y.astype(int), x.astype(int)
    ty, tx = _smooth(y - y0)[:, None], _smooth(x - x0)[None]
    top = lattice[y0][:, x0] * (1 - tx) + lattice[y0][:, x0 + 1] * tx
    bottom = lattice[y0 + 1][:, x0] * (1 - tx) + lattice[y0 + 1][:, x0 + 1] * tx
    return (top * (1 - ty) + bottom * ty).astype(np.float32)


def fractal_noise(rng: Generator, height: int, width: int, cells_y: float, cells_x: float, octaves: int) -> np.ndarray:
    """Octaves of value noise, each twice as fine and half as strong; in [0, 1]."""
    total, weight = np.zeros((height, width), np.float32), 0.0
    for octave in range(octaves):
        total += 0.5**octave * value_noise(rng, height, width, cells_y * 2**octave, cells_x * 2**octave)
        weight += 0.5**octave
    return total / weight


def _mix(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    return a * (1 - t[..., None]) + b * t[..., None]


def _palette(rng: Generator, colours: list[tuple[float, float, float]], jitter: float) -> np.ndarray:
    return np.clip(np.array(colours[rng.integers(len(colours))]) + rng.normal(0, jitter, 3), 0.02, 0.98)


def _stamp(
    picture: Picture, centre: tuple[float, float], radius: float, angle: float, colour: np.ndarray, shape
) -> None:
    """Paint, in place, where shape(u, v) > 0; u and v run over [-1, 1] within the turned square of `radius` pixels."""
    height, width = picture.shape[:2]
    reach = int(radius * 1.5) + 2
    x0, x1 = max(int(centre[0]) - reach, 0), min(int(centre[0]) + reach, width)
    y0, y1 = max(int(centre[1]) - reach, 0), min(int(centre[1]) + reach, height)
    if x0 >= x1 or y0 >= y1:
        return
    y, x = np.mgrid[y0:y1, x0:x1].astype(np.float32)
    dx, dy = (x - centre[0]) / radius, (y - centre[1]) / radius
    u, v = np.cos(angle) * dx + np.sin(angle) * dy, -np.sin(angle) * dx + np.cos(angle) * dy
    cover = np.clip(shape(u, v) * radius * 0.5 + 0.5, 0, 1)
    picture[y0:y1, x0:x1] = _mix(picture[y0:y1, x0:x1], colour, cover)


def _leaf(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    blade = 0.42 * np.clip(1 - u * u, 0, 1) * (1 - 0.35 * u) - np.abs(v)
    vein = np.abs(v) - 0.035
    return np.minimum(blade, vein)


def _flower(petals: int):
    def shape(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return 0.62 + 0.3 * np.cos(petals * np.arctan2(v, u)) - np.hypot(u, v)

    return shape


def _disc(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return 0.9 - np.hypot(u, v)


def botanical_wallpaper(rng: Generator, height: int = 1248, width: int = 2064) -> Picture:
    """Leaves and flowers strewn over cream paper with a faint stripe."""
    grain = fractal_noise(rng, height, width, 12, 20, 6)
    picture = _mix(np.array([0.80, 0.77, 0.66]), np.array([0.90, 0.87, 0.78]), grain).astype(np.float32)
    picture *= (1 - 0.05 * (np.arange(width) // 43 % 2))[None, :, None]
    greens = [(0.36, 0.48, 0.30), (0.47, 0.56, 0.36), (0.28, 0.40, 0.32), (0.58, 0.58, 0.34)]
    petals = [(0.72, 0.36, 0.30), (0.80, 0.58, 0.30), (0.62, 0.28, 0.36), (0.82, 0.70, 0.48)]
    for _ in range(1100):
        centre, radius = (rng.uniform(0, width), rng.uniform(0, height)), rng.uniform(16, 46)
        _stamp(picture, centre, radius, rng.uniform(0, 2 * np.pi), _palette(rng, greens, 0.03), _leaf)
    for _ in range(260):
        centre, radius = (rng.uniform(0, width), rng.uniform(0, height)), rng.uniform(12, 30)
        angle, count = rng.uniform(0, 2 * np.pi), int(rng.integers(5, 9))
        _stamp(picture, centre, radius, angle, _palette(rng, petals, 0.04), _flower(count))
        _stamp(picture, centre, radius * 0.3, angle, np.array([0.25, 0.17, 0.12]), _disc)
    return np.clip(picture, 0, 1)


def bricks(rng: Generator, height: int = 1248, width: int = 2064, rows: int = 34, columns: int = 18) -> Picture:
    """A painted brick wall: each brick has its own tone, pits and mortar edge."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    wobble = 3.0 * (fractal_noise(rng, height, width, 40, 60, 3) - 0.5)
    row = np.floor((y + wobble) / height * rows)
    column_at = (x + wobble) / width * columns + 0.5 * (row % 2)
    column = np.floor(column_at)
    fy, fx = (y + wobble) / height * rows - row, column_at - column
    edge = np.minimum(np.minimum(fy, 1 - fy) * height / rows, np.minimum(fx, 1 - fx) * width / columns)
    tone = rng.random((rows + 3, columns + 3, 3), dtype=np.float32)[row.astype(int) + 1, column.astype(int) + 1]
    base = np.array([0.62, 0.40, 0.31]) + (tone - 0.5) * np.array([0.26, 0.18, 0.14])
    pits = fractal_noise(rng, height, width, 60, 100, 4)
    picture = base * (0.72 + 0.5 * pits)[..., None]
    mortar = np.array([0.74, 0.70, 0.64]) * (0.8 + 0.3 * pits)[..., None]
    return np.clip(_mix(picture, mortar, np.clip((3.0 - edge) / 1.5, 0, 1)), 0, 1).astype(np.float32)


def wood(rng: Generator, height: int, width: int, colour: tuple[float, float, float], rings: float = 9.0) -> Picture:
    """Grain along x: stretched noise bent into rings, with pores."""
    bend = fractal_noise(rng, height, width, 5, 1.5, 4)
    fine = fractal_noise(rng, height, width, height / 6, 6, 3)
    ring = 0.5 + 0.5 * np.sin(2 * np.pi * rings * bend + 3.0 * fine)
    pores = fine > 0.68
    shade = 0.70 + 0.34 * ring + 0.25 * (fine - 0.5) - 0.18 * pores
    return np.clip(np.array(colour) * shade[..., None], 0, 1).astype(np.float32)


def planks(rng: Generator, height: int = 2048, width: int = 2048, rows: int = 26) -> Picture:
    """A floor of boards of unequal length along x, each cut from its own piece of wood."""
    picture = np.zeros((height, width, 3), np.float32)
    for row in range(rows):
        y0, y1, x0 = row * height // rows, (row + 1) * height // rows, int(-rng.uniform(0, 300))
        while x0 < width:
            x1 = x0 + int(rng.uniform(320, 760))
            colour = np.array([0.60, 0.42, 0.26]) * rng.uniform(0.72, 1.22) + rng.normal(0, 0.015, 3)
            board = wood(rng, y1 - y0, x1 - x0, tuple(colour), rings=rng.uniform(3, 8))
            board[:2] *= 0.35
            board[:, :2] *= 0.35
            picture[y0:y1, max(x0, 0) : min(x1, width)] = board[:, max(-x0, 0) : min(x1, width) - x0]
            x0 = x1
    return np.clip(picture, 0, 1)


def rug(rng: Generator, height: int = 1024, width: int = 1280) -> Picture:
    """A woven rug: borders of lozenges, a field of flowers and diamonds, a medallion; wool noise on top."""
    picture = np.tile(np.array([0.52, 0.16, 0.15], np.float32), (height, width, 1))
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    edge = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    for limit, colour in (
        (150, (0.78, 0.66, 0.46)),
        (138, (0.20, 0.16, 0.20)),
        (34, (0.76, 0.64, 0.44)),
        (20, (0.40, 0.12, 0.13)),
    ):
        picture[edge < limit] = colour
    colours = [(0.80, 0.66, 0.42), (0.30, 0.26, 0.22), (0.72, 0.42, 0.22), (0.62, 0.56, 0.40), (0.40, 0.36, 0.22)]
    for _ in range(700):
        cx, cy = rng.uniform(0, width), rng.uniform(0, height)
        if min(cx, cy, width - cx, height - cy) < 165:
            continue
        shape = _flower(int(rng.integers(4, 8))) if rng.random() < 0.6 else lambda u, v: 0.8 - np.abs(u) - np.abs(v)
        radius = rng.uniform(9, 26)
        _stamp(picture, (cx, cy), radius, rng.uniform(0, 1.6), _palette(rng, colours, 0.04), shape)
        _stamp(picture, (cx, cy), radius * 0.35, 0.0, _palette(rng, colours, 0.04), _disc)
    for index in range(96):
        t = index / 96 * 2 * (height + width)
        cx = np.clip(t, 0, width) if t < width + height else np.clip(2 * width + height - t, 0, width)
        cy = np.clip(t - width, 0, height) if t < width + height else np.clip(2 * (height + width) - t, 0, height)
        centre = (float(np.clip(cx, 86, width - 86)), float(np.clip(cy, 86, height - 86)))
        _stamp(
            picture,
            centre,
            rng.uniform(24, 36),
            0.0,
            _palette(rng, colours, 0.05),
            lambda u, v: 0.9 - np.abs(u) - np.abs(v),
        )
        _stamp(picture, centre, 12, 0.0, _palette(rng, colours, 0.05), _flower(4))
    weave = rng.normal(0, 0.05, (height, width, 1)) + 0.10 * (
        fractal_noise(rng, height, width, 30, 40, 4)[..., None] - 0.5
    )
    return np.clip(picture * (1 + weave), 0, 1).astype(np.float32)


def poster(rng: Generator, style: int, height: int = 512, width: int = 400) -> Picture:
    """Wall art in one of four styles: hills, cells, discs, lettering-like blocks; with a white margin."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    warm = [(0.85, 0.55, 0.25), (0.75, 0.25, 0.20), (0.93, 0.80, 0.50), (0.30, 0.22, 0.20), (0.55, 0.62, 0.42)]
    picture = np.tile(_palette(rng, warm, 0.05).astype(np.float32), (height, width, 1))
    if style == 0:
        picture = _mix(np.array([0.95, 0.75, 0.50]), np.array([0.65, 0.45, 0.45]), y / height)
        for level in range(6):
            ridge = height * (0.3 + 0.11 * level) + 120 * (fractal_noise(rng, 1, width, 1, 3 + level, 5)[0] - 0.5)
            picture[y > ridge[None]] = np.array([0.55, 0.42, 0.34]) * (1 - 0.13 * level)
        _stamp(picture, (width * 0.68, height * 0.2), 46, 0, np.array([0.98, 0.92, 0.70]), _disc)
    elif style == 1:
        seeds = rng.uniform(0, 1, (90, 2)) * (width, height)
        distance = np.hypot(x[..., None] - seeds[:, 0], y[..., None] - seeds[:, 1])
        nearest = np.sort(distance, -1)[..., :2]
        picture = np.stack([_palette(rng, warm, 0.08) for _ in seeds])[distance.argmin(-1)]
        picture[nearest[..., 1] - nearest[..., 0] < 4] = 0.12
    elif style == 2:
        for _ in range(90):
            centre, radius = (rng.uniform(0, width), rng.uniform(0, height)), rng.uniform(10, 70)
            _stamp(picture, centre, radius, 0, _palette(rng, warm, 0.08), _disc)
            _stamp(picture, centre, radius * 0.6, 0, _palette(rng, warm, 0.08), _disc)
    else:
        picture[:] = (0.90, 0.86, 0.78)
        for line in range(24):
            cursor = 40
            while cursor < width - 60:
                length, y0 = int(rng.uniform(8, 46)), 60 + line * 17
                picture[y0 : y0 + 11, cursor : min(cursor + length, width - 40)] = _palette(rng, warm, 0.1) * 0.6
                cursor += length + int(rng.uniform(5, 14))
    picture = picture * (0.9 + 0.2 * fractal_noise(rng, height, width, 40, 30, 3))[..., None]
    margin = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) < 26
    picture[margin] = (0.92, 0.90, 0.86)
    return np.clip(picture, 0, 1).astype(np.float32)


def book_spine(rng: Generator, height: int = 256, width: int = 64) -> Picture:
    """Cloth with bands and a title made of bars."""
    cloth = [
        (0.55, 0.18, 0.15),
        (0.72, 0.55, 0.25),
        (0.30, 0.34, 0.22),
        (0.45, 0.30, 0.20),
        (0.80, 0.74, 0.60),
        (0.25, 0.18, 0.22),
    ]
    base = _palette(rng, cloth, 0.05)
    picture = base * (0.85 + 0.3 * fractal_noise(rng, height, width, 40, 12, 3))[..., None]
    ink = np.array([0.88, 0.78, 0.48]) if base.mean() < 0.55 else np.array([0.25, 0.12, 0.10])
    for at in rng.uniform(0.06, 0.94, rng.integers(2, 5)):
        picture[int(at * height) : int(at * height) + int(rng.integers(3, 9))] = ink
    cursor = int(height * 0.3)
    while cursor < height * 0.72:
        length = int(rng.uniform(6, 24))
        picture[cursor : cursor + length, int(width * 0.3) : int(width * 0.7)] = ink
        cursor += length + int(rng.uniform(4, 10))
    return np.clip(picture, 0, 1).astype(np.float32)


def glaze(rng: Generator, height: int = 512, width: int = 1024) -> Picture:
    """The figure's blue glaze: waves, dots and petals in cyan and deep blue. No other thing in the room is blue."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    runs = fractal_noise(rng, height, width, 8, 16, 5)
    picture = _mix(np.array([0.06, 0.16, 0.46]), np.array([0.12, 0.34, 0.70]), runs).astype(np.float32)
    for band in range(5):
        middle = height * (0.12 + 0.19 * band)
        wave = middle + 12 * np.sin(2 * np.pi * x / width * (9 + 4 * band) + rng.uniform(0, 6))
        picture[np.abs(y - wave) < 5] = (0.35, 0.72, 0.88)
    for _ in range(240):
        centre, radius = (rng.uniform(0, width), rng.uniform(0, height)), rng.uniform(7, 24)
        colour = _palette(rng, [(0.25, 0.60, 0.85), (0.05, 0.10, 0.32), (0.45, 0.75, 0.92), (0.10, 0.42, 0.62)], 0.03)
        _stamp(picture, centre, radius, rng.uniform(0, 6), colour, _flower(int(rng.integers(4, 7))))
    return np.clip(picture * (0.88 + 0.24 * runs)[..., None], 0, 1)
