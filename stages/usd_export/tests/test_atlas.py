from dataclasses import replace

import cv2
import numpy as np
import pytest

from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.usd_export.atlas import find_texels, unwrap
from inpaint3d.stages.usd_export.fidelity import HeldOutPhoto, measure_fidelity, render_mesh
from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.rays import Caster
from inpaint3d.stages.usd_export.texture import Picture, even_exposures, fill_texture, look, measure_filled, paint

SIZE = 256


def wall(n: int = 6) -> Mesh:
    """A square of n x n cells in the plane y = 0, seen from -y."""
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, n + 1), np.linspace(-0.5, 0.5, n + 1), indexing="ij")
    vertices = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], 1)
    i, j = (v.ravel() for v in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a, b, c, d = i * (n + 1) + j, (i + 1) * (n + 1) + j, (i + 1) * (n + 1) + j + 1, i * (n + 1) + j + 1
    return Mesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def colour_at(points: np.ndarray) -> np.ndarray:
    return np.stack([points[..., 0] + 0.5, 0.3 + 0.4 * points[..., 2], 0.5 - points[..., 0] * 0.5], -1).clip(0, 1)


def camera_before_the_wall(shift: float = 0.0) -> Camera:
    return Camera(90, 90, 64, 64, 128, 128, look_at((shift, -1.2, 0.1), (0, 0, 0)))


def picture_of_the_wall(shift: float = 0.0, *, gain: float = 1.0, masked: bool = False) -> Picture:
    camera = camera_before_the_wall(shift)
    origins, directions = camera.rays()
    points = origins - (origins[..., 1] / directions[..., 1])[..., None] * directions
    image = (gain * colour_at(points)).clip(0, 1).astype(np.float32)
    return Picture(camera, image, np.ones((128, 128), bool), np.full((128, 128), masked))


def painted(pictures: list[Picture]) -> tuple[Mesh, np.ndarray, np.ndarray, np.ndarray]:
    mesh = wall()
    atlas = unwrap(mesh, SIZE)
    texels = find_texels(atlas, SIZE)
    sights = [look(mesh, Caster(mesh.vertices, mesh.triangles), picture) for picture in pictures]
    colour, known = paint(mesh, texels, even_exposures(mesh, texels, sights))
    return mesh, atlas.coordinates, fill_texture(texels, colour, known, SIZE), known


def looked_up(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """What a bilinear sampler reads at USD texture coordinates."""
    return sample_bilinear(texture, np.stack([uv[..., 0], 1 - uv[..., 1]], -1) * texture.shape[0])


def test_a_flat_wall_is_one_chart_that_fills_most_of_its_texture():
    atlas = unwrap(wall(), SIZE)
    assert atlas.charts == 1
    assert atlas.coordinates.min() >= 0
    assert atlas.coordinates.max() <= 1
    assert len(find_texels(atlas, SIZE).row) > 0.75 * SIZE**2


def test_texels_lie_in_the_triangle_that_they_name():
    atlas = unwrap(wall(), SIZE)
    texels = find_texels(atlas, SIZE)
    uv = np.einsum("nc,ncd->nd", texels.barycentric, atlas.coordinates[texels.triangle])
    centres = np.stack([(texels.column + 0.5) / SIZE, 1 - (texels.row + 0.5) / SIZE], 1)
    np.testing.assert_allclose(uv, centres, atol=1e-4)  # Embree counts in float32


def test_every_point_of_every_triangle_reads_its_own_colour():
    """Corners, edges and inside: no filter footprint reaches out of a chart into another colour."""
    mesh, uv, texture, _ = painted([picture_of_the_wall(), picture_of_the_wall(0.4)])
    inner = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.3, 0.3, 0.4]])
    points = np.einsum("pc,tcd->tpd", inner, mesh.corners())
    read = looked_up(texture, np.einsum("pc,tcd->tpd", inner, uv))
    # what the feather leaves out at the wall's border is as the nearest texel within it; a pixel is 0.013 wide
    np.testing.assert_allclose(read, colour_at(points), atol=0.02)


def test_exposures_are_evened_out_between_pictures():
    """Where one picture ends and another begins there is no step: broad differences are blended."""
    _, _, bright, _ = painted([picture_of_the_wall(-0.5, gain=0.8), picture_of_the_wall(0.5)])
    _, _, even, _ = painted([picture_of_the_wall(-0.5), picture_of_the_wall(0.5)])
    assert np.abs(np.diff(bright[SIZE // 2], axis=0)).max() < np.abs(np.diff(even[SIZE // 2], axis=0)).max() + 0.01
    assert bright.mean() < even.mean()


def test_a_picture_that_shows_nothing_in_common_keeps_its_exposure():
    mesh, picture = wall(), picture_of_the_wall()
    hidden = Picture(picture.camera, picture.image, np.zeros((128, 128), bool))
    caster = Caster(mesh.vertices, mesh.triangles)
    evened = even_exposures(
        mesh, find_texels(unwrap(mesh, SIZE), SIZE), [look(mesh, caster, p) for p in (picture, hidden)]
    )
    for sight in evened:
        np.testing.assert_array_equal(sight.picture.image, picture.image)


def test_a_picture_that_something_stands_before_paints_nothing():
    mesh = wall()
    shield = Mesh(np.array([[-9.0, -0.6, -9], [9, -0.6, -9], [0, -0.6, 9]]), np.array([[0, 1, 2]]))
    both = Mesh(
        np.concatenate([shield.vertices, mesh.vertices]), np.concatenate([shield.triangles, mesh.triangles + 3])
    )
    sight = look(both, Caster(both.vertices, both.triangles), picture_of_the_wall())
    assert sight.triangles[0]
    assert not sight.triangles[1:].any()


def test_unusable_pixels_and_backs_paint_nothing():
    mesh = wall()
    picture = picture_of_the_wall()
    texels = find_texels(unwrap(mesh, SIZE), SIZE)
    hidden = Picture(picture.camera, picture.image, np.zeros((128, 128), bool))
    sight = look(mesh, Caster(mesh.vertices, mesh.triangles), hidden)
    assert not paint(mesh, texels, [sight])[1].any()
    turned = Mesh(mesh.vertices, mesh.triangles[:, ::-1])
    behind = look(turned, Caster(turned.vertices, turned.triangles), picture)
    assert not paint(turned, find_texels(unwrap(turned, SIZE), SIZE), [behind])[1].any()


def test_a_picture_has_no_say_at_its_edges():
    """What lies there is seen in part; between pictures it would be a seam."""
    mesh = wall()
    near = Camera(90, 90, 64, 64, 128, 128, look_at((0, -0.5, 0), (0, 0, 0)))  # the wall goes on beyond the picture
    sight = look(mesh, Caster(mesh.vertices, mesh.triangles), replace(picture_of_the_wall(), camera=near))
    assert (sight.depth > 0).all()
    assert (sight.say[[0, -1]] == 0).all()
    assert (sight.say[:, [0, -1]] == 0).all()
    assert (np.diff(sight.say[64, :9]) > 0).all()
    assert sight.say[64, 64] == 1


def test_points_on_a_cameras_plane_are_not_seen_by_it():
    mesh = wall()
    beside = Camera(90, 90, 64, 64, 128, 128, look_at((0.9, 0, 0), (0.9, -1, 0)))  # all of the wall at depth 0
    before = look(mesh, Caster(mesh.vertices, mesh.triangles), picture_of_the_wall())
    sights = [before, replace(before, picture=replace(before.picture, camera=beside))]
    texels = find_texels(unwrap(mesh, SIZE), SIZE)
    both, alone = (paint(mesh, texels, some) for some in (sights, sights[:1]))
    assert both[1].any()
    for a, b in zip(both, alone, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("away", [1.0, 30.0, 1000.0])
def test_pictures_of_opposite_colours_have_an_equal_say(away):
    """Neither agrees with their mean: both must not lose all their weight, however far the surface is."""
    mesh = wall()
    mesh = Mesh(away * mesh.vertices, mesh.triangles)
    texels = find_texels(unwrap(mesh, SIZE), SIZE)
    caster = Caster(mesh.vertices, mesh.triangles)
    camera = Camera(90, 90, 64, 64, 128, 128, look_at((0, -1.2 * away, 0.1 * away), (0, 0, 0)))
    colours = [np.full((128, 128, 3), value, np.float32) for value in (0, 1)]
    sights = [look(mesh, caster, Picture(camera, colour, np.ones((128, 128), bool))) for colour in colours]
    colour, known = paint(mesh, texels, sights)
    np.testing.assert_allclose(colour[known], 0.5, rtol=0, atol=1e-3)


def test_charts_lie_apart_by_more_than_a_filters_footprint():
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    box = Mesh(corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))
    atlas = unwrap(box, 64)
    texels = find_texels(atlas, 64)
    assert atlas.charts > 1
    # On its own chart a texel's neighbours in the texture are its neighbours on the box.
    points = np.einsum("nc,ncd->nd", texels.barycentric, box.corners()[texels.triangle])
    there = np.full((64, 64, 3), np.nan)
    there[texels.row, texels.column] = points
    for rows in (there, there.swapaxes(0, 1)):
        for step in (1, 2):
            assert np.nanmax(np.linalg.norm(rows[step:] - rows[:-step], axis=-1)) < 0.1 * step


def test_what_no_picture_shows_is_grey():
    mesh = wall()
    texels = find_texels(unwrap(mesh, SIZE), SIZE)
    colour, known = paint(mesh, texels, [])
    assert not known.any()
    assert (fill_texture(texels, colour, known, SIZE) == 0.5).all()


def test_filled_is_the_share_of_the_pictures_that_mask_a_triangle():
    mesh = wall()
    caster = Caster(mesh.vertices, mesh.triangles)
    sights = [look(mesh, caster, picture_of_the_wall(masked=m)) for m in (True, False, False, True)]
    assert (measure_filled(sights) == 0.5).all()
    assert (measure_filled(sights[1:3]) == 0).all()


def test_a_render_of_the_painted_wall_is_its_photo():
    mesh, uv, texture, _ = painted([picture_of_the_wall(), picture_of_the_wall(0.4)])
    caster = Caster(mesh.vertices, mesh.triangles)
    photo = picture_of_the_wall(0.2)
    met = caster.depth(photo.camera) > 0
    inner = cv2.erode(met.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0  # SSIM looks at a window around each pixel
    found = measure_fidelity(caster, uv, texture, [HeldOutPhoto(photo.camera, photo.image, inner)])
    assert found is not None
    psnr, ssim = found
    assert psnr > 35
    assert ssim > 0.97
    assert (render_mesh(caster, uv, texture, photo.camera)[~met] == 0.5).all()
    assert measure_fidelity(caster, uv, texture, []) is None


@pytest.mark.parametrize("shift", [0.0, 0.4])
def test_depth_along_the_axis_is_that_of_the_plane(shift):
    mesh, camera = wall(), camera_before_the_wall(shift)
    depth = Caster(mesh.vertices, mesh.triangles).depth(camera)
    origins, directions = camera.rays()
    plane = -origins[..., 1] / directions[..., 1] * (directions @ camera.forward)
    assert 0.2 < (depth > 0).mean() < 0.9
    np.testing.assert_allclose(depth[depth > 0], plane[depth > 0], rtol=1e-5)
