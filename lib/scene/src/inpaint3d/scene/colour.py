"""sRGB encoding (IEC 61966-2-1) and luminance."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def srgb_from_linear(linear: ArrayLike) -> NDArray[np.floating]:
    """Encode linear light in [0, 1]; values outside are clipped."""
    x = np.clip(np.asarray(linear), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055).astype(x.dtype)


def linear_from_srgb(encoded: ArrayLike) -> NDArray[np.floating]:
    """Decode sRGB in [0, 1]; values outside are clipped."""
    x = np.clip(np.asarray(encoded), 0.0, 1.0)
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4).astype(x.dtype)


def luma(encoded: ArrayLike) -> NDArray[np.floating]:
    """Rec. 709 luma of sRGB-encoded colours [*n, 3] -> [*n]."""
    x = np.asarray(encoded)
    return x @ np.array([0.2126, 0.7152, 0.0722], x.dtype)


def from_bytes(codes: NDArray[np.generic]) -> NDArray[np.float32]:
    """0..255 -> [0, 1], as OpenImageIO converts them."""
    return codes.astype(np.float32) * np.float32(1 / 255)


def to_bytes(image: ArrayLike) -> NDArray[np.uint8]:
    """[0, 1] -> 0..255, rounded to nearest; values outside are clipped."""
    return np.rint(np.clip(np.asarray(image, np.float32), 0, 1) * 255).astype(np.uint8)
