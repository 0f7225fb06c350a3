"""Path-trace pictures of made-up rooms for a prior to learn from: `python examples/rooms/rooms.py OUT --rooms 40`.

OUT gets a folder of pictures for each room, so that `inpaint3d.stages.diffusion_training.corpus` splits them by room. A
room is drawn from (seed, its number) alone: rendering more of them later adds to what is there. See README.md.
"""

from __future__ import annotations  # Mitsuba's classes have no names before a variant is chosen

import argparse
import sys
import time
from pathlib import Path

import mitsuba as mi
import numpy as np

# Shapes, lens, path tracer, denoiser and sensor are the demo capture's.
sys.path.append(str(Path(__file__).resolve().parents[1] / "demo"))

SAMPLES = 16
EYE, CLEARANCE = (0.9, 1.8), 0.35
"""Heights of a camera, and how far it stays from walls and furniture; metres."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rooms", type=int, default=20)
    parser.add_argument("--views", type=int, default=6, help="pictures of each room")
    parser.add_argument("--side", type=int, default=256, help="longer side of the pictures, pixels")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    options = parser.parse_args()
    mi.set_variant(options.variant)
    mi.set_log_level(mi.LogLevel.Error)  # every lathe's poles have no normal, and each would be told of
    import layout

    for number in range(options.rooms):
        folder = options.out / f"seed{options.seed}_room{number:04d}"
        missing = [view for view in range(options.views) if not (folder / f"{view:02d}.jpg").exists()]
        if missing:
            room, started = layout.build(np.random.default_rng([options.seed, number])), time.process_time()
            for view in missing:
                photograph(room, folder / f"{view:02d}.jpg", options.side, [options.seed, number, view])
            print(f"{folder.name}: {(time.process_time() - started) / len(missing):.1f} CPU s a picture", flush=True)


def photograph(room, path: Path, side: int, seed: list[int]) -> None:
    """One picture, well exposed, noisy as a phone's."""
    from phone import LIGHT_TO_SENSOR, Lens, Shot, develop
    from render import path_trace, write_photo

    rng = np.random.default_rng(seed)
    lens = Lens(side, side * 3 // 4, side * rng.uniform(0.7, 1.3), 0.0)
    shot = Shot(path.stem, camera(room, rng), 0.0)
    light = path_trace(room.scene, shot, SAMPLES, int(rng.integers(2**20)), lens).astype(np.float32)
    # As a phone meters: the brighter parts just below saturation.
    metered = Shot(path.stem, shot.world_from_cam, float(np.log2(0.8 / (LIGHT_TO_SENSOR * np.percentile(light, 90)))))
    partial = path.with_name(f".{path.name}")
    write_photo(partial, develop(light, metered, rng, noise=0.5), metered)
    partial.rename(path)


def camera(room, rng: np.random.Generator) -> np.ndarray:
    """world_from_cam [3, 4] of a camera that stands free and looks at a piece of furniture or at what is on it."""
    from phone import look_at

    x, y, top = room.places[rng.integers(len(room.places))]
    target = np.array([x, y, top + rng.uniform(-0.2, 0.2)])
    for _ in range(200):
        centre = np.array([*(rng.uniform(CLEARANCE - h, h - CLEARANCE) for h in room.half), rng.uniform(*EYE)])
        away = [np.hypot(centre[0] - a, centre[1] - b) for a, b, _ in room.places]
        if min(away) > 0.5 + CLEARANCE / 2 and np.hypot(*(centre - target)[:2]) < 2.5:
            break
    return look_at(centre, target, rng.normal(0, 0.05))


if __name__ == "__main__":
    main()
