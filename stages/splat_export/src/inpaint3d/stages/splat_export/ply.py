"""Splats as the PLY of 3D Gaussian Splatting's reference implementation, which every splat viewer reads."""

from pathlib import Path

import numpy as np

from inpaint3d.stages.splat_export.cloud import Y_DOWN, SplatCloud

PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)  # fmt: skip


def write_ply(path: Path, cloud: SplatCloud) -> None:
    """Binary, a float for each property: y down and z forward, as viewers take it; logarithms of the scales, logits of
    the opacities, coefficients of degree 0, quaternions w, x, y, z; normals, which nothing reads, are 0.
    """
    turned = cloud.turn(Y_DOWN)
    normals = np.zeros_like(turned.mean)
    rows = [turned.mean, normals, turned.coefficients, turned.opacity[:, None], turned.log_scale, turned.quaternion]
    properties = "".join(f"property float {name}\n" for name in PROPERTIES)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(cloud)}\n{properties}end_header\n"
    path.write_bytes(header.encode() + np.concatenate(rows, 1).astype("<f4").tobytes())
