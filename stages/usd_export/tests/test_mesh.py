import numpy as np
import pytest

from inpaint3d.radiance.surface_views import DOME, SurfaceView, close_off
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.planes import Plane
from inpaint3d.stages.usd_export.contraction import contract, expand, measure_stretch
from inpaint3d.stages.usd_export.fusion import Volume, depth_ahead, fuse
from inpaint3d.stages.usd_export.guides import visual_hull
from inpaint3d.stages.usd_export.mesh import Mesh, extract, flatten, label_pieces, remove_floaters, simplify
from inpaint3d.stages.usd_export.rays import Caster
from inpaint3d.stages.usd_export.surface import bounds_of, find_seen, make_surface


def ball_volume(radius: float = 0.6, n: int = 33) -> Volume:
    axis = np.linspace(-1, 1, n)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    distance = np.clip((np.sqrt(x * x + y * y + z * z) - radius) / 0.2, -1, 1).astype(np.float32)
    return Volume(np.full(3, -1.0), 2 / (n - 1), distance, np.ones(distance.shape, bool))


def views_of_a_ball(radius: float = 0.5, count: int = 12) -> list[SurfaceView]:
    out = []
    for i in range(count):
        angle, height = 2 * np.pi * i / count, 1.2 * (-1) ** i
        pose = look_at((2 * np.cos(angle), 2 * np.sin(angle), height), (0, 0, 0))
        camera = Camera(60, 60, 32, 32, 64, 64, pose)
        origins, directions = camera.rays()
        b = (origins * directions).sum(-1)
        under = b * b - (origins**2).sum(-1) + radius**2
        hit = under > 0
        t = -b - np.sqrt(np.where(hit, under, 0))
        depth = np.where(hit, t * (directions @ camera.forward), 0).astype(np.float32)
        out.append(SurfaceView(camera, np.full((64, 64, 3), 0.5, np.float32), depth))
    return out


def test_a_ball_has_its_radius_and_faces_outwards():
    mesh = extract(ball_volume())
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.6, atol=0.01)
    outward = (mesh.normals() * mesh.corners().mean(1)).sum(1)
    assert (outward > 0).all()


def test_the_ball_is_closed():
    triangles = extract(ball_volume()).triangles
    edges = np.concatenate([triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    forward = {tuple(e) for e in edges.tolist()}
    assert len(forward) == len(edges) > 1000, "no edge is walked twice the same way"
    assert all((b, a) in forward for a, b in forward)


def test_what_was_not_seen_has_no_surface():
    volume = ball_volume()
    volume.known[: volume.known.shape[0] // 2] = False
    assert extract(volume).vertices[:, 0].min() >= -1e-6


@pytest.mark.parametrize("distance", [0.5, -0.5])
def test_a_volume_without_a_surface_is_an_empty_mesh(distance):
    flat = np.full((4, 4, 4), distance, np.float32)
    assert len(extract(Volume(np.zeros(3), 1.0, flat, np.ones(flat.shape, bool))).triangles) == 0


def test_fused_depth_of_a_ball_is_a_ball():
    views = [close_off(view) for view in views_of_a_ball()]
    mesh = extract(fuse(views, (np.full(3, -0.7), np.full(3, 0.7)), grid=100, truncation_cells=3))
    error = np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.5)
    # a pixel is 0.03 wide at the ball, whose silhouettes are uncertain by as much
    assert np.median(error) < 0.005
    assert np.quantile(error, 0.99) < 0.03


def test_depth_ahead_is_along_the_axis_and_says_nothing_outside():
    camera = Camera(10, 10, 5, 5, 10, 10, look_at((0, -1, 0), (0, 0, 0)))
    view = SurfaceView(camera, np.zeros((10, 10, 3), np.float32), np.full((10, 10), 2.0, np.float32))
    points = np.array([[0, 0, 0], [0.2, 0.5, 0.1], [0, 2, 0], [0, -2, 0], [9, 0, 0]])
    assert depth_ahead(view, points).tolist() == pytest.approx([1.0, 0.5, -1.0, -np.inf, -np.inf])
    empty = SurfaceView(camera, view.rgb, np.zeros_like(view.depth))
    assert np.isneginf(depth_ahead(empty, points)).all()


def test_small_pieces_are_dropped_with_their_vertices():
    ball = extract(ball_volume())
    floater = np.array([[5.0, 5, 5], [6, 5, 5], [5, 6, 5]])
    both = Mesh(np.concatenate([floater, ball.vertices]), np.concatenate([[[0, 1, 2]], ball.triangles + 3]))
    kept = remove_floaters(both, 0.01)
    assert len(kept.triangles) == len(ball.triangles)
    assert len(kept.vertices) == len(ball.vertices)
    assert len(remove_floaters(both, 0.0).triangles) == len(ball.triangles) + 1


def test_a_long_strip_is_one_piece():
    rng = np.random.default_rng(0)
    name = rng.permutation(1000)
    strip = name[np.stack([np.arange(998), np.arange(1, 999), np.arange(2, 1000)], 1)]
    assert len(np.unique(label_pieces(1000, strip))) == 1


def test_contracted_points_come_back():
    rng = np.random.default_rng(0)
    points = rng.standard_normal((500, 3)) * 10.0 ** rng.uniform(-3, 1.5, (500, 1))
    inside = contract(points)
    assert np.linalg.norm(inside, axis=1).max() < 2
    assert (expand(np.zeros((2, 3))) == 0).all()
    np.testing.assert_allclose(expand(inside), points, rtol=1e-9)
    # a short radial step of contracted space, carried out into the scene
    radial = inside / np.linalg.norm(inside, axis=1, keepdims=True)
    step = np.linalg.norm(expand(inside + 1e-7 * radial) - points, axis=1) / 1e-7
    np.testing.assert_allclose(measure_stretch(points), step, rtol=1e-2)


def test_bounds_are_those_of_what_is_seen_in_contracted_space():
    views = views_of_a_ball()
    low, high = bounds_of(views)
    np.testing.assert_allclose(high - low, 1.0, atol=0.15)
    low, high = bounds_of([close_off(view) for view in views])
    assert (high - low).max() < 4
    assert (high - low).max() > 3.8


def test_a_dome_closes_off_what_shows_no_surface():
    view = views_of_a_ball()[0]
    closed = close_off(view)
    seen = view.depth > 0
    np.testing.assert_array_equal(closed.depth[seen], view.depth[seen])
    camera = view.camera
    behind = camera.unproject(camera.pixel_centres()[~seen], closed.depth[~seen])
    np.testing.assert_allclose(np.linalg.norm(behind, axis=1), DOME, rtol=1e-5)


def test_every_ray_of_every_view_meets_the_surface_of_a_closed_off_scene():
    """No cracks, and no wall that is missing: ball and dome are there wherever a view looks."""
    views = [close_off(view) for view in views_of_a_ball()]
    mesh = make_surface(views, bounds_of(views), grid=48, truncation_cells=3, smallest_piece=0.0, triangles=20_000)
    caster = Caster(mesh.vertices, mesh.triangles)
    met = np.concatenate([caster.look(view.camera).triangle >= 0 for view in views])
    assert met.mean() > 0.998
    assert find_seen(mesh, views).mean() > 0.5


def test_simplified_planes_stay_flat_and_few_triangles_are_left():
    ball = extract(ball_volume())
    few = simplify(ball, 300)
    assert len(few.triangles) <= 300
    np.testing.assert_allclose(np.linalg.norm(few.vertices, axis=1), 0.6, atol=0.05)
    assert simplify(ball, 10**6) is ball


def test_what_is_nearly_flat_is_brought_onto_its_plane_and_the_rest_left():
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), 0.02 * rng.standard_normal(400)], 1)
    vertices[0, 2] = 5.0
    i = (np.arange(19)[:, None] * 20 + np.arange(19)).ravel()
    floor = Mesh(vertices, np.concatenate([np.stack([i, i + 20, i + 1], 1), np.stack([i + 1, i + 20, i + 21], 1)]))
    flat = flatten(floor, [Plane(np.array([0.0, 0, 1]), 0.0)], np.full(400, 0.2))
    assert flat.vertices[0, 2] == 5.0
    assert np.abs(flat.vertices[50:, 2]).max() == 0
    np.testing.assert_array_equal(flat.vertices[:, :2], vertices[:, :2])


def test_the_hull_of_a_balls_silhouettes_holds_the_ball():
    views = views_of_a_ball()
    masks = [v.depth > 0 for v in views]
    hull = visual_hull([v.camera for v in views], masks, np.full(3, -1.0), np.full(3, 1.0), 40)
    radii = np.linalg.norm(hull.vertices, axis=1)
    assert radii.min() > 0.44
    assert radii.max() < 0.85
    nothing = visual_hull([v.camera for v in views], [~m & m for m in masks], np.full(3, -1.0), np.full(3, 1.0), 8)
    assert len(nothing.triangles) == 0
    alone = visual_hull([views[0].camera], [masks[0]], np.full(3, -1.0), np.full(3, 1.0), 8)
    assert len(alone.triangles) == 0, "a single silhouette goes on for ever"


def test_normals_that_cancel_out_are_along_z():
    mesh = Mesh(np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 1, 2], [0, 2, 1]]))
    np.testing.assert_array_equal(mesh.vertex_normals(), np.tile([0.0, 0, 1], (3, 1)))
