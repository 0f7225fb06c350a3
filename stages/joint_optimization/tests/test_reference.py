"""Pictures of what lies behind the hole, on the synthetic room, whose picture without the ball is known."""

import numpy as np
import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.stages.joint_optimization.appearance import Recolour
from inpaint3d.stages.joint_optimization.reference import completed
from inpaint3d.stages.joint_optimization.scene import SceneView
from inpaint3d.stages.joint_optimization.texture import telea


class Plain(Recolour):
    """Of a field without codes."""

    def __init__(self) -> None:
        self._codes = None


@pytest.fixture(scope="module")
def large() -> SyntheticScene:
    return synthetic_scene(views=8, width=96, height=72)


def views_of(room: SyntheticScene) -> list[SceneView]:
    return [
        SceneView(n, c, np.where(m[..., None], 0, i).astype(np.float32), m, ~m)
        for n, c, i, m in zip(room.names, room.cameras, room.images, room.object_masks, strict=True)
    ]


def depths_of(room: SyntheticScene) -> dict[str, np.ndarray]:
    return {n: d.astype(np.float32) for n, d in zip(room.names, room.empty_depths, strict=True)}


def error(room: SyntheticScene, pictures: list[np.ndarray]) -> float:
    apart = [np.abs(p - e)[m] for p, e, m in zip(pictures, room.empty_images, room.object_masks, strict=True)]
    return float(np.concatenate(apart).mean())


def test_what_others_show_is_recovered_as_it_is(large: SyntheticScene) -> None:
    """With the true depth behind the ball the pictures come far nearer to the empty room than a smooth filling."""
    views = views_of(large)
    made, words = completed(views, depths_of(large), Plain(), witnesses=2, references=3)
    pictures = [one.picture for one in made]
    smooth = [telea(v.image, v.hole) for v in views]
    assert error(large, pictures) < 0.6 * error(large, smooth)
    assert words.endswith(tuple(large.names))
    for view, picture in zip(views, pictures, strict=True):
        np.testing.assert_array_equal(picture[view.known], view.image[view.known])


def test_what_is_made_up_is_the_same_from_every_view(large: SyntheticScene) -> None:
    """A point of the floor under the ball has one colour, however many views it is seen from."""
    views = views_of(large)
    made, _ = completed(views, depths_of(large), Plain(), witnesses=2, references=3)
    pictures = [one.picture for one in made]
    smooth = [telea(v.image, v.hole) for v in views]
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    floor = np.stack([0.05 * np.cos(angles), 0.05 * np.sin(angles), np.full(24, -0.2)], -1)

    def spread(shown: list[np.ndarray]) -> float:
        colours = []
        for view, picture in zip(views, shown, strict=True):
            x, y = view.camera.project(floor)[0].astype(int).T
            assert view.hole[y, x].all()
            colours.append(picture[y, x])
        return float(np.std(colours, 0).mean())

    assert spread(pictures) < 0.5 * spread(smooth)


def test_a_surface_that_no_photo_shows_is_spanned_and_carried(large: SyntheticScene) -> None:
    """A field's depth says nothing where only masks look; the floor there is found from what lies around."""
    views = views_of(large)
    lost = {}
    for name, camera, hole, depth in zip(
        large.names, large.cameras, large.object_masks, large.empty_depths, strict=True
    ):
        points = camera.unproject(camera.pixel_centres(), depth)
        under_the_ball = hole & (np.hypot(points[..., 0], points[..., 1]) < 0.2)
        assert under_the_ball.any()
        lost[name] = np.where(under_the_ball, 0.4 * depth, depth).astype(np.float32)
    made, _ = completed(views, lost, Plain(), witnesses=2, references=3)
    for one, depth in zip(made, large.empty_depths, strict=True):
        wrong = np.abs(lost[one.view.name] / depth - 1)[one.view.hole]
        left = np.abs(one.depth / depth - 1)[one.view.hole]
        assert left.mean() < 0.25 * wrong.mean()


def test_a_picture_in_the_mean_appearance_and_back(room: SyntheticScene) -> None:
    """The codes' gain and offset act on logits, as in the field; views of one code are left as they are."""
    spec = FieldSpec.model_validate(
        {
            "proposal_grid": {"levels": 1, "coarsest": 4, "finest": 4, "log2_table": 6, "channels": 1},
            "grid": {"levels": 1, "coarsest": 4, "finest": 4, "log2_table": 6, "channels": 1},
            "proposal_samples": [2], "samples": 2, "density_width": 4, "bottleneck": 3, "view_width": 4,
            "view_layers": 0, "contraction": False, "bound": 1.0, "glo": 2, "glo_views": 3, "near": 0.1, "far": 3.0,
        }
    )  # fmt: skip
    field = RadianceField(spec, seed=0)
    image = room.images[0].clip(0.05, 0.95)
    with torch.no_grad():
        field.codes.copy_(torch.tensor([[0.3, -0.2], [0.3, -0.2], [-0.4, 0.1]]))
    recolour = Recolour(field)
    there = recolour.to_mean(image, 2)
    assert np.abs(there - image).max() > 0.02
    np.testing.assert_allclose(recolour.from_mean(there, 2), image, atol=1e-4)
    own, mean = field.appearance(torch.tensor([2]), "view"), field.appearance(None, "mean")
    points, along = torch.rand(64, 3, generator=torch.Generator().manual_seed(0)), torch.tensor([[0.0, 0.0, 1.0]])
    assert own is not None
    with torch.no_grad():
        shown, wanted = (field.query(points, along.expand(64, 3), code.expand(64, 6)).rgb for code in (own, mean))
    made = recolour.to_mean(shown[None].numpy(), 2)[0]
    np.testing.assert_allclose(made, wanted.numpy(), atol=1e-4)


def test_known_elsewhere_or_made_up_is_told_apart(large: SyntheticScene) -> None:
    """With depth on the ball itself no other photo knows what is masked: all of it has to be made up."""
    views = views_of(large)
    true, wrong = (
        completed(views, depths, Plain(), witnesses=2, references=1)[1]
        for depths in (depths_of(large), dict(zip(large.names, large.depths.astype(np.float32), strict=True)))
    )
    share, none = (int(words.split("%")[0]) for words in (true, wrong))
    assert share > 30
    assert none < 15
