import json
import struct

import numpy as np
import trimesh

from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.usd_export.gltf import write_glb, write_point_cloud
from inpaint3d.stages.usd_export.mesh import Mesh

# a unit square in the plane z = 1, its corners at the corners of the texture
SQUARE = Mesh(np.array([[0.0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]), np.array([[0, 1, 2], [0, 2, 3]]))
UV = SQUARE.corners()[..., :2].astype(np.float32)


def test_another_reader_gets_the_mesh_with_y_up_and_its_texture(tmp_path):
    rng = np.random.default_rng(0)
    texture = (rng.integers(0, 256, (8, 8, 3)) / 255).astype(np.float32)
    write_png(tmp_path / "t.png", texture)
    write_glb(tmp_path / "m.glb", SQUARE, UV, tmp_path / "t.png")
    (mesh,) = trimesh.load(tmp_path / "m.glb", process=False).geometry.values()
    assert len(mesh.vertices) == 4, "corners that share a place are one"
    at = np.array(mesh.vertices[mesh.faces])
    # z up to y up: (x, y, z) becomes (x, z, -y)
    np.testing.assert_allclose(at, SQUARE.corners()[..., [0, 2, 1]] * (1, 1, -1), atol=1e-6)
    np.testing.assert_allclose(mesh.visual.uv[mesh.faces], UV, atol=1e-6)
    image = np.asarray(mesh.visual.material.baseColorTexture)
    np.testing.assert_array_equal(image, np.round(texture * 255).astype(np.uint8))


def test_the_mesh_is_unlit_and_equal_scenes_give_equal_bytes(tmp_path):
    write_png(tmp_path / "t.png", np.full((4, 4, 3), 0.5, np.float32))
    for name in ("a.glb", "b.glb"):
        write_glb(tmp_path / name, SQUARE, UV, tmp_path / "t.png")
    data = (tmp_path / "a.glb").read_bytes()
    assert data == (tmp_path / "b.glb").read_bytes()
    total, length = struct.unpack_from("<8xII", data)
    assert total == len(data)
    document = json.loads(data[20 : 20 + length])
    assert document["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}


def test_another_reader_gets_the_point_cloud(tmp_path):
    rng = np.random.default_rng(0)
    points, colours = rng.standard_normal((50, 3)), rng.integers(0, 256, (50, 3))
    write_point_cloud(tmp_path / "p.ply", points, np.tile([0.0, 0, 1], (50, 1)), colours / 255)
    cloud = trimesh.load(tmp_path / "p.ply", process=False)
    np.testing.assert_allclose(cloud.vertices, points, rtol=1e-6)
    np.testing.assert_array_equal(np.asarray(cloud.colors)[:, :3], colours)
