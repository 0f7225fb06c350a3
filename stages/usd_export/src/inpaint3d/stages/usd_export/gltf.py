"""A mesh as binary glTF 2.0 with its texture inside, and as a PLY point cloud; both for tools that read no USD."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inpaint3d.scene.glb import write_glb_file
from inpaint3d.stages.usd_export.mesh import Mesh

_FLOAT, _UINT = 5126, 5125
# glTF's y is up; the scene's z is.
_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def write_glb(path: Path, mesh: Mesh, coordinates: NDArray[np.float32], texture: Path) -> None:
    """The mesh, coordinates [t, 3, 2] as USD has them, with a PNG as its unlit colour (KHR_materials_unlit)."""
    corner_uv = coordinates.reshape(-1, 2) * (1, -1) + (0, 1)  # glTF counts v downwards
    index = mesh.triangles.ravel()
    # Corners that share a vertex and a place in the texture are one.
    keys = np.concatenate([index[:, None], np.round(corner_uv * 2**20)], 1)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    points = (mesh.vertices[index[first]] @ _Y_UP.T).astype(np.float32)
    normals = (mesh.vertex_normals()[index[first]] @ _Y_UP.T).astype(np.float32)
    png = texture.read_bytes()
    arrays = [points, normals, corner_uv[first].astype(np.float32), inverse.ravel().astype(np.uint32)]
    blobs = [array.tobytes() for array in arrays] + [png + bytes(-len(png) % 4)]
    starts = np.cumsum([0] + [len(blob) for blob in blobs])
    kinds = ("VEC3", "VEC3", "VEC2", "SCALAR")
    accessors = [
        {"bufferView": i, "componentType": _UINT if a.dtype == np.uint32 else _FLOAT, "count": len(a), "type": kind}
        for i, (a, kind) in enumerate(zip(arrays, kinds, strict=True))
    ]
    accessors[0] |= {"min": points.min(0).tolist(), "max": points.max(0).tolist()}
    material = {"baseColorTexture": {"index": 0}, "metallicFactor": 0}
    document = {
        "asset": {"version": "2.0", "generator": "inpaint3d"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "Surface"}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}]}
        ],
        "materials": [
            {"pbrMetallicRoughness": material, "doubleSided": True, "extensions": {"KHR_materials_unlit": {}}}
        ],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "images": [{"bufferView": 4, "mimeType": "image/png"}],
        "accessors": accessors,
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(starts[i]), "byteLength": len(png) if i == 4 else len(blob)}
            for i, blob in enumerate(blobs)
        ],
        "buffers": [{"byteLength": int(starts[-1])}],
    }
    write_glb_file(path, document, b"".join(blobs))


def write_point_cloud(path: Path, points: ArrayLike, normals: ArrayLike, colours: ArrayLike) -> None:
    """Points, unit normals and sRGB colours in [0, 1], [n, 3] each, as binary PLY in scene units, z up."""
    points, normals, colours = (np.asarray(a, np.float32) for a in (points, normals, colours))
    kind = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    rows = np.empty(len(points), np.dtype([*kind, ("red", "u1"), ("green", "u1"), ("blue", "u1")]))
    for names, values in ((("x", "y", "z"), points), (("nx", "ny", "nz"), normals)):
        for name, column in zip(names, values.T, strict=True):
            rows[name] = column
    for name, column in zip(("red", "green", "blue"), colours.T, strict=True):
        rows[name] = np.round(column * 255)
    properties = "".join(
        f"property {'uchar' if rows.dtype[n] == 'u1' else 'float'} {n}\n" for n in rows.dtype.names or ()
    )
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    path.write_bytes(header.encode() + rows.tobytes())
