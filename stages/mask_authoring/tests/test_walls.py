"""Things that hang at a wall or lie on it, and the wall itself: ray-cast, with exact masks."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts.masks import ObjectRequest
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.geometry import ray_box, ray_sphere
from inpaint3d.scene.morphology import shrink
from inpaint3d.stages.mask_authoring.author import author
from inpaint3d.stages.mask_authoring.scene import Scene
from inpaint3d.stages.mask_authoring.segment import Prompts, iou, segment
from inpaint3d.stages.mask_authoring.surroundings import find_planes, lie_on, show_plane
from inpaint3d.stages.mask_authoring.views import DepthView
from tests.mask_bench import FAST

WIDTH, HEIGHT = 120, 160
WALL, SHIELD, HEAD, POSTER = range(4)
SHIELD_CENTRE, SHIELD_SIZE = (0.0, 0.03, 0.0), (0.3, 0.06, 0.5)
HEAD_CENTRE, HEAD_RADIUS = (0.0, 0.15, 0.07), 0.13
POSTER_LOW, POSTER_HIGH = (0.3, -0.2), (0.6, 0.25)  # x and z; painted on the wall, without any thickness
RIM = (-0.12, -0.08)  # z where the head's fur ends on the shield, and where depth is wrong
COLOUR = np.array([[0.85, 0.8, 0.75], [0.3, 0.2, 0.15], [0.7, 0.45, 0.2], [0.2, 0.35, 0.6]])


@dataclass(frozen=True, eq=False)
class Wall:
    """A head on a shield that hangs at the wall y = 0, and a poster beside it; which surface each pixel shows."""

    scene: Scene
    surfaces: list[np.ndarray]
    work: Path

    def pixel(self, view: int, *xyz: float) -> list[float]:
        return [float(v) for v in self.scene.views[view].camera.project(np.array(xyz))[0]]

    def author(self, points: list[list[float]]) -> list[np.ndarray]:
        request = ObjectRequest.model_validate({"kind": "object", "view": "view_2", "points": points})
        ctx = Context(seed=0, device="cpu", threads=1, work=self.work, emit=lambda event, **values: None)
        return author(request, self.scene, 0.0, FAST, ctx).masks

    def score(self, masks: list[np.ndarray], *surfaces: int) -> list[float]:
        """IoU in each view with the pixels that show one of the surfaces."""
        return [iou(mask, np.isin(surface, surfaces)) for mask, surface in zip(masks, self.surfaces, strict=True)]


def hang(work: Path) -> Wall:
    rng = np.random.default_rng(0)
    grain = sum(cv2.GaussianBlur(rng.normal(size=(512, 512, 3)), (0, 0), s) * s for s in (1.5, 5.0, 12.0))
    names, views, depth_views, surfaces = [], [], [], []
    for i, angle in enumerate(np.deg2rad([-40, -20, 0, 20, 40])):
        centre = (1.1 * np.sin(angle), 1.1 * np.cos(angle), 0.15)
        camera = Camera(130, 130, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT, look_at(centre, (0.05, 0, 0)))
        surface, xyz, _ = cast(camera)
        picture = paint(surface, xyz, grain)
        names.append(f"view_{i}")
        views.append(View(names[-1], camera, "train", None, Path("not read")))
        depth_views.append(DepthView(names[-1], camera, mistake(camera, rng), lambda picture=picture: picture))
        surfaces.append(surface)
    flat = np.stack([rng.uniform(-0.9, 0.9, 1500), rng.normal(0, 0.001, 1500), rng.uniform(-0.8, 0.8, 1500)], 1)
    hidden = (np.abs(flat[:, 0]) < SHIELD_SIZE[0] / 2) & (np.abs(flat[:, 2]) < SHIELD_SIZE[2] / 2)
    return Wall(Scene(views, depth_views, [], True, flat[~hidden].astype(np.float32)), surfaces, work)


def cast(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which surface pixels show [h, w], where it is [h, w, 3], and its depth [h, w]."""
    origins, directions = camera.rays()
    wall = -origins[..., 1] / directions[..., 1]
    wall = np.where(wall > 0, wall, 50.0)
    shield, _, _ = ray_box(origins, directions, SHIELD_CENTRE, SHIELD_SIZE)
    head, _, _ = ray_sphere(origins, directions, HEAD_CENTRE, HEAD_RADIUS)
    distances = np.stack([wall, shield, head])
    surface, nearest = distances.argmin(0), distances.min(0)
    xyz = origins + nearest[..., None] * directions
    in_poster = np.all((xyz[..., ::2] > POSTER_LOW) & (xyz[..., ::2] < POSTER_HIGH), -1)
    return np.where((surface == WALL) & in_poster, POSTER, surface), xyz, nearest * (directions @ camera.forward)


def paint(surface: np.ndarray, xyz: np.ndarray, grain: np.ndarray) -> np.ndarray:
    """The picture, float32 [h, w, 3]: every surface in a colour of its own, in the same grain."""
    column, row = (np.floor((xyz[..., i] + 1.5) * 170).astype(int) % 512 for i in (0, 2))
    return np.clip(COLOUR[surface] + 0.05 * grain[row, column] / grain.std(), 0, 1).astype(np.float32)


def mistake(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """Depth at half the picture's size, 0.3 % off; under the head half of it falls through the shield to the wall."""
    small = camera.resize_to(WIDTH // 2, HEIGHT // 2)
    surface, xyz, depth = cast(small)
    origins, directions = small.rays()
    through = -origins[..., 1] / directions[..., 1] * (directions @ small.forward)
    wrong = (surface == SHIELD) & (xyz[..., 2] > RIM[0]) & (xyz[..., 2] < RIM[1]) & (rng.random(depth.shape) < 0.5)
    return np.where(wrong, through, depth) * (1 + 0.003 * rng.normal(size=depth.shape))


@pytest.fixture(scope="module")
def wall(tmp_path_factory) -> Wall:
    return hang(tmp_path_factory.mktemp("work"))


def test_what_hangs_at_a_wall_is_found_whole_where_depth_falls_through_it(wall):
    points = [wall.pixel(2, 0, 0.28, 0.07), wall.pixel(2, 0, 0.06, -0.2)]
    assert min(wall.score(wall.author(points), SHIELD, HEAD)) > 0.97


def test_what_lies_flat_on_a_wall_is_told_from_it_by_colour(wall):
    assert min(wall.score(wall.author([wall.pixel(2, 0.45, 0, 0)]), POSTER)) > 0.97


def test_a_wall_pointed_at_is_no_object(wall):
    with pytest.raises(ConfigurationError, match=r"nothing was found.*view_2.*a part of a wall.*`scribble`"):
        wall.author([wall.pixel(2, -0.4, 0, 0)])


def test_a_plane_shows_where_it_is_and_not_where_single_depths_fall_on_it(wall):
    (plane,) = find_planes(wall.scene.points, wall.scene.depth_views)
    for view, surface in zip(wall.scene.depth_views, wall.surfaces, strict=True):
        xy = view.camera.pixel_centres().reshape(-1, 2)
        on_it = lie_on(plane, view.camera.unproject(xy, view.depth_at(xy)), view).reshape(surface.shape)
        hanging = np.isin(surface, (SHIELD, HEAD))
        inside, beside = shrink(hanging, 4), shrink(~hanging, 4)  # pixels; along outlines depth is coarser
        assert on_it[inside].mean() > 0.02
        assert show_plane(plane, view)[inside].mean() < 0.5 * on_it[inside].mean()
        assert show_plane(plane, view)[beside].mean() > 0.97


@pytest.mark.parametrize("own", [2.0, np.inf])
def test_a_thing_before_the_open_sky_is_found_where_the_sky_has_no_depth(own):
    """own: depth of the thing itself, inf where the field has no surface for it either."""
    camera = Camera(60, 60, 32, 24, 64, 48, look_at((0, -2, 0), (0, 0, 0)))
    disc = np.linalg.norm(camera.pixel_centres() - (32, 24), axis=-1) < 9
    sky = np.random.default_rng(0).normal(0.7, 0.02, (48, 64, 3))
    picture = np.where(disc[..., None], sky - (0.1, 0.4, 0.5), sky).clip(0, 1).astype(np.float32)
    depth = np.where(disc, own, np.inf)
    depth[24, 28] = np.inf  # a point of the two is on a pixel without a surface
    view = DepthView("view", camera, depth, lambda: picture)
    found = segment(view, Prompts(np.array([[32.0, 24.0], [28.5, 24.5]]), np.zeros((0, 2))), rounds=2, seed=0)
    assert iou(found, disc) > 0.9


def test_a_field_without_a_surface_has_no_planes():
    """Within a tolerance of 0 lies nothing, not even what is flat to the bit."""
    camera = Camera(40, 40, 16, 12, 32, 24, look_at((0, -2, 1), (0, 0, 0)))
    nothing = DepthView("a", camera, np.full((24, 32), np.inf), lambda: np.zeros((24, 32, 3), np.float32))
    flat = np.random.default_rng(0).uniform(-1, 1, (500, 3)).astype(np.float32) * (1, 1, 0)
    assert find_planes(flat.astype(np.float32), [nothing]) == []
    surface = DepthView("a", camera, np.full((24, 32), 2.0), nothing.image)
    assert len(find_planes(flat.astype(np.float32), [surface])) == 1
    assert find_planes(np.zeros((0, 3), np.float32), [surface]) == []
