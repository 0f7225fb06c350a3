"""A light denoiser for path-traced pictures: surface colour divided out, then edge-avoiding wavelets.

Dammertz et al. 2010 (a-trous), with the variance-guided luminance weight of Schied et al. 2017 (SVGF). Textures come
through untouched, because only the irradiance is filtered.
"""

import numpy as np

KERNEL = np.array([1, 4, 6, 4, 1]) / 16.0


def _shifted(picture: np.ndarray, dy: int, dx: int) -> np.ndarray:
    height, width = picture.shape[:2]
    return picture[np.clip(np.arange(height) + dy, 0, height - 1)][:, np.clip(np.arange(width) + dx, 0, width - 1)]


def _luminance(rgb: np.ndarray) -> np.ndarray:
    return rgb @ np.array([0.2126, 0.7152, 0.0722], rgb.dtype)


def denoise(
    rgb: np.ndarray, variance: np.ndarray, albedo: np.ndarray, normal: np.ndarray, depth: np.ndarray, rounds: int = 3
) -> np.ndarray:
    """rgb [h, w, 3] with the variance of its mean; albedo, normal [h, w, 3] and depth [h, w] of the first surface."""
    divisor = np.maximum(albedo, 0.02)  # metals and mirrors have no diffuse colour: theirs is one constant
    light = rgb / divisor
    # smoothed over 3x3: a variance from few samples is itself noisy
    spread = variance / _luminance(divisor) ** 2
    spread = np.mean([_shifted(spread, dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)], axis=0)
    slope = np.maximum(np.abs(np.gradient(depth, axis=0)), np.abs(np.gradient(depth, axis=1)))
    for level in range(rounds):
        step = 2**level
        total, weights, squares = np.zeros_like(light), np.zeros_like(depth), np.zeros_like(depth)
        bright = _luminance(light)
        for i, dy in enumerate(range(-2, 3)):
            for j, dx in enumerate(range(-2, 3)):
                y, x = dy * step, dx * step
                facing = np.clip((normal * _shifted(normal, y, x)).sum(-1), 0, 1) ** 64
                away = np.abs(depth - _shifted(depth, y, x)) / (slope * np.hypot(y, x) + 1e-3 * depth + 1e-9)
                differs = np.abs(bright - _shifted(bright, y, x)) / (2.5 * np.sqrt(spread) + 1e-4)
                weight = KERNEL[i] * KERNEL[j] * facing * np.exp(-away - differs)
                if dy == dx == 0:
                    weight = np.full_like(depth, KERNEL[i] * KERNEL[j])  # a pixel without a normal still counts itself
                total += weight[..., None] * _shifted(light, y, x)
                squares += weight**2 * _shifted(spread, y, x)
                weights += weight
        light, spread = total / weights[..., None], squares / weights**2
    return light * divisor
