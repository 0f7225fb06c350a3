"""Cameras, poses and points that are degenerate, far away or of another size."""

import math
from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import Registration
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.geometry import Similarity, nearest_point_to_axes, ray_box, ray_sphere, rotation_between
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.normals import normals_of
from inpaint3d.scene.reprojection import correspondences, sample_bilinear, warp_image
from inpaint3d.scene.windows import choose_fixed_windows, draw_window
from inpaint3d.stages.capture_ingest.lenses import StatedLens, fit_camera
from inpaint3d.stages.pose_estimation.gate import check_spread
from inpaint3d.stages.pose_estimation.model import round_points, round_pose, round_to_digits
from inpaint3d.stages.pose_estimation.normalise import find_local_frame, normalise
from inpaint3d.stages.usd_export.fusion import Volume
from inpaint3d.stages.usd_export.mesh import Mesh, extract, remove_floaters, remove_slivers
from tests.stability.catalogue import hard_case

REPROJECTION, POSES, HOLES, EXPORT = "Reprojection", "Poses", "Thin holes", "Export"
CAMERA = Camera(20, 20, 8, 8, 16, 16, look_at((0, -2, 0.5), (0, 0, 0)))
BEHIND = Camera(20, 20, 8, 8, 16, 16, look_at((0, -6, 1.5), (0, 0, 0)))
BESIDE = Camera(20, 20, 8, 8, 16, 16, look_at((0.5, -2, 0.5), (0, 0, 0)))


def ring(count: int = 12, height: float = 1.0) -> np.ndarray:
    angles = np.deg2rad(np.linspace(0, 200, count))
    return np.stack([look_at((2 * np.cos(a), 2 * np.sin(a), height), (0.2, -0.1, 0.3)) for a in angles])


def turned(poses: np.ndarray, scale: float, shift: np.ndarray, towards: tuple[float, float, float]) -> np.ndarray:
    moved = Similarity(scale, rotation_between((0, 0, 1), towards), shift)
    return np.stack([moved.pose(pose) for pose in poses])


@hard_case(
    REPROJECTION,
    plain="x / z at z = 0, inf - inf, NaN as an index",
    ours="a surface is finite and before the camera; where there is none nothing is seen",
    swept="depths of 0, -1, 1e-30, 1e30, NaN, inf; finite pixels and no seen pixel",
)
@pytest.mark.parametrize("depth", [0.0, -1.0, 1e-30, 1e30, math.nan, math.inf, -math.inf])
def test_depths_of_no_surface(depth: float) -> None:
    z = np.full((16, 16), depth)
    xy, seen = correspondences(CAMERA, z, BESIDE, np.full((16, 16), 2.0))
    assert not seen.any()
    assert np.isfinite(xy[seen]).all()
    # Seen from further back, what lies behind a camera lies before another.
    assert not correspondences(CAMERA, z, BEHIND)[1].any() or depth in (1e-30, 1e30)
    picture, shown = warp_image(np.ones((16, 16, 3)), BESIDE, z, CAMERA, np.full((16, 16), 2.0))
    assert np.isfinite(picture).all()
    assert not shown.any()
    assert np.isfinite(normals_of(CAMERA, z)).all()


@hard_case(
    REPROJECTION,
    plain="points on and behind the camera's plane project somewhere",
    ours="only what lies before it is inside",
    swept="points 1e-300 to 1e300 behind, on and before the plane, in the centre itself",
)
@pytest.mark.parametrize("z", [-1e300, -1.0, -1e-300, 0.0, 1e-300, 1.0, 1e300])
def test_points_around_the_camera(z: float) -> None:
    point = CAMERA.centre + z * CAMERA.forward
    xy, depth = CAMERA.project(point)
    inside = bool(CAMERA.inside(xy, depth))
    assert inside <= (z > 0)
    assert inside == (z >= 1.0)
    back = CAMERA.unproject(xy if inside else np.array([8.0, 8.0]), 1.0)
    assert np.isfinite(back).all()


@hard_case(
    REPROJECTION,
    plain="interpolation beyond the border reads what is not there",
    ours="the border goes on",
    swept="pixels 1e9 outside, on the edge, pictures of 1 px",
)
@pytest.mark.parametrize("at", [-1e9, -0.5, 0.0, 0.5, 1.0, 1e9])
@pytest.mark.parametrize("side", [1, 2])
def test_sampling_beyond_the_border(at: float, side: int) -> None:
    assert sample_bilinear(np.full((side, side, 3), 0.25), np.array([[at, at]])).tolist() == [[0.25] * 3]


@hard_case(
    REPROJECTION,
    plain="|o|^2 - (o.d)^2 loses all digits for a small sphere far away; 0 / 0 in the plane of a face",
    ours="by the perpendicular; such a pair of faces does not limit",
    swept="distances 1 to 1e8, origins inside, rays along faces",
)
@pytest.mark.parametrize("away", [1.0, 1e3, 1e6, 1e8])
@pytest.mark.parametrize("radius", [1e-3, 0.5])
def test_rays_against_volumes(away: float, radius: float) -> None:
    near, far, hit = ray_sphere([0, -away - radius, 0], [0, 1, 0], [0, 0, 0], radius)
    assert hit
    assert float(far - near) == pytest.approx(2 * radius, rel=1e-3, abs=1e-7)
    low, high, hit = ray_box([radius, -away - 1, 0], [0, 1, 0], [0, 0, 0], [2 * radius, 1, 1])
    assert hit
    assert float(high - low) == pytest.approx(1, rel=1e-6, abs=1e-6)
    assert ray_sphere([0, 0, 0], [0, 1, 0], [0, 0, 0], radius)[0] == 0


@hard_case(
    REPROJECTION,
    plain="r^2 beyond 1e308 is an error of Python, or inf - inf: a mask request of such a sphere ends a run",
    ours="a sphere of any size holds all or nothing; the mask of all or of nothing is refused",
    swept="radii of 1e-300 to 1e300 around the ray's origin, and 1e300 away",
    told="`the sphere mask is in none of the N views; move or enlarge it ...`, `... covers 100.0% of the views' pixels "
    "...; make it smaller ...` (exit code 2)",
)
@pytest.mark.parametrize("radius", [1e-300, 1e-150, 1e100, 1e160, 1e300])
def test_spheres_of_any_size(radius: float) -> None:
    near, far, hit = ray_sphere([0, -1, 0], [0, 1, 0], [0, 0, 0], radius)
    assert hit
    assert near == (0 if radius > 1 else 1)
    assert far >= 1
    assert not ray_sphere([0, 0, 0], [0, 1, 0], [1e300, 0, 0], min(radius, 1e290))[2]
    assert not ray_sphere([0, 0, 0], [0, 1, 0], [0, -1e300, 0], 1.0)[2]


@hard_case(
    POSES,
    plain="nine digits shared by rotation and translation: centres at 1e5 turn the camera by 5e-4",
    ours="rotations and translations are rounded apart",
    swept="centres 0 to 1e7; rotations within 1e-9, centres within 1e-9 of their size",
)
@pytest.mark.parametrize("away", [0.0, 1.0, 1e3, 1e5, 1e7])
def test_rounding_of_poses(away: float) -> None:
    pose = ring()[3]
    pose[:, 3] += away * np.array([1.0, -0.5, 0.25])
    rounded = round_pose(pose)
    np.testing.assert_allclose(rounded[:, :3], pose[:, :3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(rounded[:, 3], pose[:, 3], rtol=0, atol=1e-9 * max(away, 1) * 10)
    # Digits beyond those that repeat are gone.
    noise = np.full((3, 4), 1e-14)
    noise[:, 3] *= max(away, 1)
    np.testing.assert_array_equal(round_pose(pose + noise), rounded)


@hard_case(
    POSES,
    plain="one point at 1e6 rounds all others by 5e-3, a focal length its lens's distortion by 1e-5",
    ours="each as its own size allows",
    swept="one point at 1e3 to 1e12 among points of 1; k1 = -0.0512345678 beside f = 3000",
)
@pytest.mark.parametrize("away", [1e3, 1e6, 1e12])
def test_rounding_of_points(away: float) -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    points[7] *= away
    rounded = round_points(points)
    np.testing.assert_allclose(np.delete(rounded, 7, 0), np.delete(points, 7, 0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(rounded[7], points[7], rtol=1e-8)
    lens = np.array([3000.0, 960.0, 540.0, -0.0512345678])
    kept = round_to_digits(lens, np.maximum(np.abs(lens), 1))
    np.testing.assert_allclose(kept[:3], lens[:3], rtol=0, atol=1e-5)
    assert kept[3] == pytest.approx(lens[3], abs=1e-9)
    assert round_points(np.zeros((0, 3))).shape == (0, 3)


@hard_case(
    POSES,
    plain="in a survey's coordinates the translations of cameras lose six digits: refused, or rounded",
    ours="a local frame around the cameras, of a power of two, in float64",
    swept="shifts of 0, 1e3 to 1e7 (UTM), sizes 1e-6 to 1e6, three rotations: one normalised world within 1e-6",
)
@pytest.mark.parametrize("shift", [0.0, 1e3, 1e5, 1e7])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (1.0, -2.0, 0.5), (0.0, 0.0, -1.0)])
def test_any_world_gives_the_same_one(shift: float, scale: float, up: tuple[float, float, float]) -> None:
    # A world of 1e-6 cannot be told apart 1e7 away: float64 has 16 digits.
    offset = shift * max(scale, 1e-3) * np.array([0.5, 5.0, 0.02])
    xyz = np.random.default_rng(0).normal(size=(60, 3))
    expected = normalise(ring(), xyz, 0)
    given = turned(ring(), scale, offset, up)
    local = find_local_frame(given[:, :, 3])
    poses = np.stack([round_pose(local.pose(pose)) for pose in given])
    points = local.points(Similarity(scale, rotation_between((0, 0, 1), up), offset).points(xyz))
    found = normalise(poses, points, 0)
    np.testing.assert_allclose(
        found.normalised_from_source.points(poses[:, :, 3]),
        expected.normalised_from_source.points(ring()[:, :, 3]),
        rtol=0,
        atol=2e-5 if scale < 1 and shift > 1e4 else 1e-6,
    )
    assert found.centre_depth == pytest.approx(expected.centre_depth, rel=1e-5)
    # The way back to the user's world is exact where a user looks: in its own digits.
    back = local.then(found.normalised_from_source).inverse()
    np.testing.assert_allclose(
        back.points(found.normalised_from_source.points(poses[:, :, 3])), given[:, :, 3], rtol=1e-9, atol=1e-6 * scale
    )


@hard_case(
    POSES,
    plain="one far camera squeezes the scene to a thousandth of its cube, and passes",
    ours="refused by name",
    swept="one of 12 cameras 1, 3, 5, 20, 1000 and 1e6 times as far away",
    told="`far from all other cameras stand those of NAME (1000 times as far as most); check their poses, or leave "
    "these views out` (exit code 3)",
)
@pytest.mark.parametrize("times", [1.0, 3.0, 5.0, 20.0, 1e3, 1e6])
def test_a_far_camera(times: float) -> None:
    poses = ring()
    poses[4, :, 3] = (0.2, -0.1, 0.3) + times * (poses[4, :, 3] - (0.2, -0.1, 0.3))
    names = [f"frame_{i}" for i in range(12)]
    if times <= 5:
        check_spread(poses[:, :, 3], names)
    else:
        with pytest.raises(BadInputError, match=r"stand those of frame_4 .\d+ times as far"):
            check_spread(poses[:, :, 3], names)


@hard_case(
    POSES,
    plain="a focal length of 1e-6, a k1 of 1e6: all rays are one, and agree with any pose; another slip is named",
    ours="refused by the angle of view, and by how far the lens moves the picture's corner",
    swept="focal lengths 1e-6 to 1e9 of a picture of 160 px; k1, k2, p1 of -100 to 1e300, perspective and fisheye",
    told="`DOCUMENT: the camera of PICTURE has the focal length 1e-06; for 160x120 pixels it is 8 to 800000; ...` "
    "(exit code 3)",
)
@pytest.mark.parametrize(
    ("focal", "bends", "sound"),
    [
        (1e-6, (), False), (1.0, (), False), (9.0, (), True), (152.0, (), True), (7e5, (), True), (1e6, (), False),
        (1e9, (), False), (152.0, (-0.3, 0.1), True), (152.0, (-100.0,), False), (152.0, (1e3,), False),
        (152.0, (1e300,), False), (152.0, (0.0, -1e3), False), (152.0, (0.0, 0.0, 1e4), False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("model", ["OPENCV", "OPENCV_FISHEYE"])
def test_lenses_that_there_are_not(
    tmp_path: Path, focal: float, bends: tuple[float, ...], sound: bool, model: str
) -> None:
    write_png(tmp_path / "a.png", np.zeros((120, 160, 3)))
    further = (*bends, 0.0, 0.0, 0.0, 0.0)[:4]
    lens = StatedLens(model, (focal, focal, 80.0, 60.0, *further), (160, 120))
    if sound:
        assert fit_camera(tmp_path / "a.png", lens, ring()[0], "poses.json").params == lens.params
        return
    what = "focal length" if focal != 152 else "distortion"
    with pytest.raises(BadInputError, match=rf"^poses\.json: the camera of a\.png has the {what} .*export it again"):
        fit_camera(tmp_path / "a.png", lens, ring()[0], "poses.json")


@hard_case(
    POSES,
    plain="cameras that float64 cannot tell apart: `matches contradict them`, as if their order were wrong",
    ours="refused by the extent, against the distance from the origin",
    swept="12 cameras 0, 1e-320 to 1e-6 apart, at 0, 1e6 and 1e9",
    told="`all 12 cameras stand within 1e-09 of each other, 1e+06 from the origin: in one point, from which no depth "
    "can be told; check their positions, or set pose-estimation.cameras=estimate ...` (exit code 3)",
)
@pytest.mark.parametrize("away", [0.0, 1e6, 1e9])
@pytest.mark.parametrize("extent", [0.0, 1e-320, 1e-200, 1e-12, 1e-6])
def test_cameras_in_one_point(away: float, extent: float) -> None:
    centres, names = extent * ring()[:, :, 3] + away, [f"view_{i}" for i in range(12)]
    if extent > max(1e-13 * away, 1e-100):
        check_spread(centres, names)
        return
    with pytest.raises(BadInputError, match=r"all 12 cameras stand within .* in one point"):
        check_spread(centres, names)


@hard_case(
    POSES,
    plain="a scale of 1 / 0 where all cameras stand in one point; parallel axes meet nowhere",
    ours="a ridge towards the cameras' middle; cameras without any extent are refused",
    swept="pure rotation, parallel and opposite axes, two cameras, one line, one point",
    told="`all cameras stand in one point, at what they look at; check their poses` (exit code 3)",
)
@pytest.mark.parametrize("kind", ["rotation", "parallel", "opposite", "two", "line", "point"])
def test_degenerate_cameras(kind: str) -> None:
    poses = ring(6)
    if kind == "rotation":
        poses[:, :, 3] = 0
    elif kind == "parallel":
        poses = np.stack([look_at((x, -3, 0), (x, 0, 0)) for x in np.linspace(-1, 1, 6)])
    elif kind == "opposite":
        poses = np.stack([look_at((0, y, 0), (0, 0, 0)) for y in (-2.0, 2.0, -1.0, 1.0)])
    elif kind == "two":
        poses = poses[:2]
    elif kind == "line":
        poses = np.stack([look_at((0, -y, 0), (0, 0, 0)) for y in (1.0, 2.0, 3.0)])
    else:
        poses = np.repeat(poses[:1], 4, 0)
    assert np.isfinite(nearest_point_to_axes(poses[:, :, 3], poses[:, :, 2])).all()
    world = normalise(poses, np.zeros((0, 3)), 0)
    assert np.isfinite(world.normalised_from_source.matrix).all()
    assert np.linalg.norm(world.normalised_from_source.points(poses[:, :, 3]), axis=1).max() <= 1


@hard_case(
    POSES,
    plain="axes that are opposite have no smallest rotation between them: 1 / (1 + cos) at cos = -1",
    ours="any axis across will do",
    swept="angles of 0, 1e-12, 90, 180 - 1e-7 and 180 degrees, lengths 1e-100 to 1e100",
)
@pytest.mark.parametrize("degrees", [0.0, 1e-12, 90.0, 180 - 1e-7, 180.0])
@pytest.mark.parametrize("length", [1e-100, 1.0, 1e100])
def test_rotation_between_any_directions(degrees: float, length: float) -> None:
    angle = np.deg2rad(degrees)
    a, b = np.array([1.0, 0.0, 0.0]) * length, np.array([np.cos(angle), np.sin(angle), 0.0]) * length
    turn = rotation_between(a, b)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(turn @ [1.0, 0.0, 0.0], b / length, atol=1e-6)


@hard_case(
    POSES,
    plain="NaN fails no comparison: an error of NaN passed as small",
    ours="contracts take finite figures only",
    swept="NaN, inf and -inf as a reprojection error, an angle, a pose",
    told="the field's name and value (exit code 3)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_figures_of_poses_are_finite(value: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        Registration(
            source="known", given=2, registered=2, mean_reprojection_error_px=value, points=3,
            median_triangulation_angle_deg=1.0,
        )  # fmt: skip


@hard_case(
    HOLES,
    plain="rays that are further apart than the hole is wide miss it: 180 of 240 windows on a line of 1 px",
    ours="a smaller window, whose rays miss no pixel",
    swept="a pixel, a row, a column, a diagonal in pictures of 24 to 360 px; windows of 8 to 64 rays, spans 0.2 to 1",
)
@pytest.mark.parametrize("kind", ["pixel", "row", "column", "diagonal", "corner"])
@pytest.mark.parametrize("side", [24, 97, 360])
@pytest.mark.parametrize("size", [8, 16, 64])
def test_windows_hit_thin_holes(kind: str, side: int, size: int) -> None:
    hole = np.zeros((side, side + 5), bool)
    middle = side // 2 + 1
    where = {"pixel": np.s_[middle, middle], "row": np.s_[middle], "column": np.s_[:, middle], "corner": np.s_[-1, -1]}
    if kind == "diagonal":
        hole[np.arange(side), np.arange(side)] = True
    else:
        hole[where[kind]] = True
    rng = np.random.default_rng(0)
    for span in (0.2, 0.7, 1.0):
        for source in (rng, rng, rng, None):
            window = draw_window(hole, ~hole, 0, size=size, span=span, min_known=0.2, rng=source)
            assert window is not None
            assert window.sample(hole).any()
    view = MaskedView("a", CAMERA, np.zeros((*hole.shape, 3), np.float32), hole, ~hole)
    (fixed,) = choose_fixed_windows([view], size=size, span=0.9, min_known=0.2)
    assert fixed is not None
    assert fixed.sample(hole).any()


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_a_window_of_a_view_that_is_nearly_all_hole_takes_what_is_known(side: str) -> None:
    known = np.zeros((20, 30), bool)
    known[{"left": np.s_[:, 0], "right": np.s_[:, -1], "top": np.s_[0], "bottom": np.s_[-1]}[side]] = True
    window = draw_window(~known, known, 0, size=8, span=0.5, min_known=0.9, rng=np.random.default_rng(0))
    assert window is not None
    assert window.sample(known).any()


def volume(distance: np.ndarray, cell: float = 1.0, low: float = 0.0) -> Volume:
    return Volume(np.full(3, low), cell, distance.astype(np.float32), np.ones(distance.shape, bool))


def ball(n: int = 9) -> np.ndarray:
    axis = np.linspace(-1, 1, n)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.sqrt(x * x + y * y + z * z) - 0.6


@hard_case(
    EXPORT,
    plain="marching cubes fails on volumes without a surface, and makes triangles without area",
    ours="an empty mesh; slivers are left out relative to their own size",
    swept="all free, all solid, all zero, one point; scenes 1e-6 and 1e6 wide, 1e6 away",
)
@pytest.mark.parametrize("kind", ["free", "solid", "zero", "point"])
def test_volumes_without_a_surface(kind: str) -> None:
    distance = {"free": np.ones((4, 4, 4)), "solid": -np.ones((4, 4, 4)), "zero": np.zeros((4, 4, 4))}.get(kind)
    if distance is None:
        distance = np.ones((4, 4, 4))
        distance[2, 2, 2] = -1
    mesh = extract(volume(distance))
    assert np.isfinite(mesh.vertices).all()
    assert (len(mesh.triangles) > 0) == (kind == "point")
    assert remove_floaters(mesh, 0.1).triangles.shape[1] == 3


@hard_case(
    EXPORT,
    plain="absolute thresholds of area keep nothing of a small scene and everything of a large one",
    ours="area is compared with the longest side",
    swept="1e-6, 1 and 1e6 wide: as many triangles, normals of length 1",
)
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_scenes_of_any_size(scale: float) -> None:
    mesh = extract(volume(ball(), cell=scale))
    assert len(mesh.triangles) == len(extract(volume(ball())).triangles) > 100
    np.testing.assert_allclose(np.linalg.norm(mesh.normals(), axis=1), 1, rtol=1e-6)


@hard_case(
    EXPORT,
    plain="a normal of 0 / 0 for a triangle without area",
    ours="zero normals, and such triangles are left out",
    swept="coincident and collinear corners, edges shared by three triangles, no triangle",
)
@pytest.mark.parametrize("kind", ["coincident", "collinear", "non-manifold", "empty"])
def test_degenerate_triangles(kind: str) -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]], float)
    triangles = {
        "coincident": [[0, 0, 0]], "collinear": [[0, 1, 2]], "non-manifold": [[0, 1, 3], [0, 1, 4], [0, 1, 5]],
        "empty": np.empty((0, 3)),
    }[kind]  # fmt: skip
    mesh = Mesh(vertices, np.array(triangles, np.int64).reshape(-1, 3))
    assert np.isfinite(mesh.normals()).all()
    kept = remove_slivers(mesh) if len(mesh.triangles) else mesh
    assert len(kept.triangles) == (3 if kind == "non-manifold" else 0)
