"""How far a lens moves the corner of the picture. Models and parameter orders are COLMAP's."""

import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import LensModel


def corner_displacement(lens: LensModel) -> float:
    """Pixels of the captured picture between its corner with and without distortion.

    The principal point is taken for the picture's middle. BadInputError for a model that is not known here.
    """
    p = lens.params
    match lens.model:
        case "SIMPLE_PINHOLE" | "PINHOLE":
            return 0.0
        case "SIMPLE_RADIAL":
            (fx, cx, cy), fy, coefficients = p[:3], p[0], (p[3], 0.0, 0.0, 0.0)
        case "RADIAL":
            (fx, cx, cy), fy, coefficients = p[:3], p[0], (p[3], p[4], 0.0, 0.0)
        case "OPENCV":
            fx, fy, cx, cy = p[:4]
            coefficients = p[4:8]
        case "OPENCV_FISHEYE":
            return _displace_fisheye(*p)
        case _:
            raise BadInputError(
                f"lens model {lens.model} is not known; run pose-estimation with a PINHOLE, RADIAL or OPENCV model"
            )
    return _displace_brown(fx, fy, cx / fx, cy / fy, *coefficients)


def _displace_brown(fx: float, fy: float, x: float, y: float, k1: float, k2: float, p1: float, p2: float) -> float:
    """Brown's model at the point (x, y) of the plane z = 1."""
    r2 = x * x + y * y
    radial = k1 * r2 + k2 * r2 * r2
    dx = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    dy = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return float(np.hypot(fx * dx, fy * dy))


def _displace_fisheye(fx: float, fy: float, cx: float, cy: float, *k: float) -> float:
    """Kannala-Brandt at the corner, against the pinhole of the same focal length."""
    x, y = cx / fx, cy / fy
    radius = np.hypot(x, y)
    theta = np.arctan(radius)
    bent = theta * (1 + sum(c * theta ** (2 * i + 2) for i, c in enumerate(k)))
    return float(abs(bent / radius - 1) * np.hypot(fx * x, fy * y))
