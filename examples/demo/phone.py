"""What a phone does to light on its way to a JPEG, and where a hand holds it.

Cameras are OpenCV (x right, y down, z forward); pixel centres lie at +0.5. Lens: COLMAP's SIMPLE_RADIAL,
distorted = undistorted * (1 + k1 r^2) with r in units of the focal length.
"""

from dataclasses import dataclass

import numpy as np

NOMINAL_EXPOSURE_S, NOMINAL_ISO, F_NUMBER = 1 / 60, 160, 1.8
SHOT_NOISE, READ_NOISE = 1.6e-4, 1.5e-3  # variance per unit of signal, standard deviation; at nominal ISO
LIGHT_TO_SENSOR = 1.15  # scene radiance times this is 1 at the sensor's saturation, at nominal exposure


@dataclass(frozen=True)
class Lens:
    """COLMAP's SIMPLE_RADIAL with the principal point in the middle; pixels."""

    width: int
    height: int
    focal_px: float
    k1: float


PHONE = Lens(480, 360, 402.0, -0.072)


@dataclass(frozen=True)
class Shot:
    """One press of the button: where the phone was, and its exposure against the nominal one in stops."""

    name: str
    world_from_cam: np.ndarray  # [3, 4]
    exposure_ev: float


def look_at(centre: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """world_from_cam [3, 4] of an OpenCV camera at `centre`, turned by `roll` radians about its axis."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    x = np.cos(roll) * right + np.sin(roll) * down
    y = -np.sin(roll) * right + np.cos(roll) * down
    return np.column_stack([x, y, forward, centre])


def hand_held_arc(at: np.ndarray, rng: np.random.Generator, focus: np.ndarray) -> list[np.ndarray]:
    """Poses at `at` [n] in [0, 1] on 110 degrees around `focus`: two sweeps of height, a shaky hand."""
    poses = []
    for t in at:
        azimuth = np.radians(-45 + 110 * (t - 0.5)) + rng.normal(0, 0.01)
        distance = 1.55 + 0.22 * np.sin(2 * np.pi * (1.3 * t + 0.1)) + rng.normal(0, 0.025)
        elevation = np.radians(21 + 11 * np.sin(2 * np.pi * (2.1 * t + 0.55))) + rng.normal(0, 0.012)
        level, rise = np.cos(elevation), np.sin(elevation)
        offset = distance * np.array([level * np.cos(azimuth), level * np.sin(azimuth), rise])
        aim = focus + rng.normal(0, 0.05, 3) + [0, 0, 0.04]
        poses.append(look_at(focus + offset, aim, rng.normal(0, np.radians(1.5))))
    return poses


def shots(seed: int, frames: int, truths: int, focus: np.ndarray) -> tuple[list[Shot], list[Shot]]:
    """The capture with the object, in capture order with drifting exposure, and the truth views between its poses."""
    rng = np.random.default_rng([seed, 100])
    at = (np.arange(frames) + 0.5) / frames
    drift = np.sin(2 * np.pi * (1.15 * at + 0.2)) + 0.45 * np.sin(2 * np.pi * (3.1 * at + 0.6))
    drift -= drift.mean()  # the mean of the capture is the nominal exposure that the truth is shown at
    drift *= 0.25 / np.abs(drift).max()
    taken = [
        Shot(f"frame_{i:03d}", pose, float(ev))
        for i, (pose, ev) in enumerate(zip(hand_held_arc(at, rng, focus), drift, strict=True))
    ]
    between = (np.arange(truths) + 0.5) / truths + rng.uniform(-0.2, 0.2, truths) / truths
    shown = [Shot(f"truth_{i:03d}", pose, 0.0) for i, pose in enumerate(hand_held_arc(between, rng, focus))]
    return taken, shown


def undistort(xy: np.ndarray, k1: float) -> np.ndarray:
    """Undo the lens by fixed-point iteration: [..., 2] in units of the focal length, distorted -> pinhole."""
    pinhole = xy.copy()
    for _ in range(20):
        pinhole = xy / (1 + k1 * (pinhole**2).sum(-1, keepdims=True))
    return pinhole


def pixel_rays(shot: Shot, offsets: np.ndarray, lens: Lens = PHONE) -> tuple[np.ndarray, np.ndarray]:
    """World rays through each pixel's corner + offsets [h, w, s, 2]: origin [3], unit directions [h, w, s, 3]."""
    corner = np.stack(np.meshgrid(np.arange(lens.width), np.arange(lens.height)), -1)[:, :, None]
    plane = undistort((corner + offsets - [lens.width / 2, lens.height / 2]) / lens.focal_px, lens.k1)
    camera = np.concatenate([plane, np.ones_like(plane[..., :1])], -1)
    directions = camera @ shot.world_from_cam[:, :3].T
    return shot.world_from_cam[:, 3], directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def exif(shot: Shot) -> tuple[float, int]:
    """Exposure time in seconds and ISO whose product drifts as the picture does (ISO steps, time does the rest)."""
    ratio = 2.0**shot.exposure_ev
    iso = int(round(NOMINAL_ISO * ratio**0.5 / 8) * 8)
    return NOMINAL_EXPOSURE_S * NOMINAL_ISO * ratio / iso, iso


def develop(radiance: np.ndarray, shot: Shot, rng: np.random.Generator, noise: float = 1.0) -> np.ndarray:
    """Linear radiance [h, w, 3] -> sRGB-encoded uint8; `noise` scales the sensor's noise."""
    signal = np.maximum(radiance.astype(np.float64), 0) * LIGHT_TO_SENSOR * 2.0**shot.exposure_ev
    gain = exif(shot)[1] / NOMINAL_ISO
    deviation = noise * np.sqrt(SHOT_NOISE * gain * signal + (READ_NOISE * gain) ** 2)
    linear = np.clip(signal + deviation * rng.normal(size=signal.shape), 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(encoded * 255).astype(np.uint8)
