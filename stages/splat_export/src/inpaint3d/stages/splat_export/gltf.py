"""Splats as binary glTF 2.0 with KHR_gaussian_splatting: points, for tools that do not know the extension."""

from pathlib import Path

import numpy as np

from inpaint3d.scene.colour import linear_from_srgb, to_bytes
from inpaint3d.scene.glb import write_glb_file
from inpaint3d.stages.splat_export.cloud import Y_UP, SplatCloud

EXTENSION = "KHR_gaussian_splatting"
_FLOAT, _BYTE, _ARRAY_BUFFER, _POINTS = 5126, 5121, 34962, 0
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def write_glb(path: Path, cloud: SplatCloud) -> None:
    """Y up; scales as they are, opacities in [0, 1], coefficients of degree 0, quaternions x, y, z, w; colours of the
    display, which COLOR_0 repeats in light for tools that show points.
    """
    turned = cloud.turn(Y_UP)
    shown = np.concatenate([linear_from_srgb(turned.rgb), turned.alpha[:, None]], 1)
    arrays = {
        "POSITION": turned.mean,
        f"{EXTENSION}:ROTATION": np.roll(turned.quaternion, -1, axis=1),
        f"{EXTENSION}:SCALE": np.exp(turned.log_scale),
        f"{EXTENSION}:OPACITY": turned.alpha[:, None],
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": turned.coefficients,
        "COLOR_0": to_bytes(shown),
    }
    blobs = [np.ascontiguousarray(array).tobytes() for array in arrays.values()]
    starts = np.cumsum([0] + [len(blob) for blob in blobs])
    accessors = [_describe(array, view) for view, array in enumerate(arrays.values())]
    accessors[0] |= {"min": turned.mean.min(0).tolist(), "max": turned.mean.max(0).tolist()}
    how = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    how |= {"projection": "perspective", "sortingMethod": "cameraDistance"}
    primitive = {
        "attributes": {name: accessor for accessor, name in enumerate(arrays)},
        "mode": _POINTS,
        "extensions": {EXTENSION: how},
    }
    document = {
        "asset": {"version": "2.0", "generator": "inpaint3d"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "Splats"}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(start), "byteLength": len(blob), "target": _ARRAY_BUFFER}
            for start, blob in zip(starts[:-1], blobs, strict=True)
        ],
        "buffers": [{"byteLength": int(starts[-1])}],
    }
    write_glb_file(path, document, b"".join(blobs))


def _describe(array: np.ndarray, view: int) -> dict[str, object]:
    byte = array.dtype == np.uint8
    kind = {"componentType": _BYTE, "normalized": True} if byte else {"componentType": _FLOAT}
    return {"bufferView": view, "count": len(array), "type": _KINDS[array.shape[1]], **kind}
