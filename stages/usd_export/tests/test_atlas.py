import numpy as np
import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.usd_export import atlas
from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.surface_views import SurfaceView


def wall(n: int = 6) -> Mesh:
    """A square of n x n cells in the plane y = 0, seen from -y."""
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, n + 1), np.linspace(-0.5, 0.5, n + 1), indexing="ij")
    vertices = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], 1)
    i, j = (v.ravel() for v in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a, b, c, d = i * (n + 1) + j, (i + 1) * (n + 1) + j, (i + 1) * (n + 1) + j + 1, i * (n + 1) + j + 1
    return Mesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def colour_at(points: np.ndarray) -> np.ndarray:
    return np.stack([points[..., 0] + 0.5, 0.3 + 0.4 * points[..., 2], 0.5 - points[..., 0] * 0.5], -1)


def view_of_the_wall(shift: float = 0.0) -> SurfaceView:
    camera = Camera(90, 90, 64, 64, 128, 128, look_at((shift, -1.2, 0.1), (0, 0, 0)))
    origins, directions = camera.rays()
    t = -origins[..., 1] / directions[..., 1]
    points = origins + t[..., None] * directions
    depth = (t * (directions @ camera.forward)).astype(np.float32)
    return SurfaceView(camera, colour_at(points).clip(0, 1).astype(np.float32), depth)


def looked_up(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """What a bilinear sampler reads at USD texture coordinates."""
    size = texture.shape[0]
    return sample_bilinear(texture, np.stack([uv[..., 0], 1 - uv[..., 1]], -1) * size)


def baked(mesh: Mesh, views: list[SurfaceView], blended: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    plan = atlas.layout(len(mesh.triangles), 1024)
    chosen, weight = atlas.best_views(mesh, views, blended, 0.05)
    return atlas.bake(mesh, views, plan, chosen, weight), atlas.coordinates(plan, len(mesh.triangles)), weight


def test_every_point_of_every_triangle_reads_its_own_colour():
    """Corners, edges and inside: no filter footprint reaches into another triangle's texels."""
    mesh = wall()
    texture, uv, _ = baked(mesh, [view_of_the_wall(), view_of_the_wall(0.4)])
    inner = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.3, 0.3, 0.4]])
    points = np.einsum("pc,tcd->tpd", inner, mesh.corners())
    read = looked_up(texture, np.einsum("pc,tcd->tpd", inner, uv))
    # the photos' pixels are 0.013 wide, over which the colour moves by as much
    np.testing.assert_allclose(read, colour_at(points), atol=0.01)


def test_the_nearer_and_straighter_view_is_best():
    mesh = wall()
    far = view_of_the_wall(3.0)
    chosen, weight = atlas.best_views(mesh, [far, view_of_the_wall()], 1, 0.05)
    assert (chosen == 1).all()
    assert (weight > 0).all()


def test_a_triangle_behind_something_or_turned_away_is_not_shown():
    view = view_of_the_wall()
    hidden = SurfaceView(view.camera, view.rgb, view.depth * 0.5)
    assert (atlas.best_views(wall(), [hidden], 1, 0.05)[1] == 0).all()
    turned = Mesh(wall().vertices, wall().triangles[:, ::-1])
    assert (atlas.best_views(turned, [view], 1, 0.05)[1] == 0).all()


def test_a_triangle_that_no_view_shows_is_grey():
    mesh = wall()
    away = view_of_the_wall()
    away = SurfaceView(away.camera, away.rgb, np.zeros_like(away.depth))
    texture, uv, weight = baked(mesh, [away])
    assert (weight == 0).all()
    assert (looked_up(texture, uv) == 0.5).all()


@pytest.mark.parametrize("triangles", [1, 2, 3, 500, 9001])
def test_triangles_stay_within_their_half_squares(triangles):
    plan = atlas.layout(triangles, 1024)
    texel = atlas.coordinates(plan, triangles).astype(np.float64)
    texel = np.stack([texel[..., 0], 1 - texel[..., 1]], -1) * plan.size
    assert texel.min() >= 0.5 - 1e-3
    assert texel.max() <= plan.size - 0.5 + 1e-3
    square = np.floor(texel / plan.square).astype(int)
    assert (square == square[:, :1]).all()
    assert plan.leg >= 2


def test_too_many_triangles_for_the_texture_say_how_to_repair_it():
    with pytest.raises(ConfigurationError, match="lower grid or raise texture_size"):
        atlas.layout(100_000, 256)
