import numpy as np
import pytest
import torch

from inpaint3d.radiance.line_of_sight import SightLines, line_of_sight_loss, opacity_before
from inpaint3d.radiance.rays import join_rays
from inpaint3d.radiance.rendering import Rendering
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.capture_io import SparsePoints

CAMERAS = [Camera(60, 60, 24, 18, 48, 36, look_at((0.9, y, 0.3), (0, 0, 0))) for y in (-0.2, 0.2)]
XYZ = np.array([[0, 0, 0], [-0.3, 0.1, 0.2], [0.1, 0.3, -0.1]], np.float32)
POINTS = SparsePoints(
    xyz=XYZ, rgb=np.zeros((3, 3), np.uint8), error=np.zeros(3, np.float32), track_offsets=np.array([0, 2, 3, 5]),
    track_frame=np.array([0, 1, 1, 0, 1], np.int32), track_xy=np.zeros((5, 2), np.float32),
)  # fmt: skip
TDIST = torch.tensor([[0.0, 0.5, 0.9, 1.1, 2.0]])


def seen(*weights: float) -> Rendering:
    """Rays, alike, in which light stops where it is said."""
    one, rows = torch.zeros(1, 3), torch.tensor([weights]).requires_grad_()
    nothing = torch.zeros(1)
    return Rendering(one, one, nothing, nothing, nothing, rows, TDIST, TDIST, [])


def test_rays_lead_from_the_camera_to_the_point_that_it_saw() -> None:
    sighted = SightLines.of(CAMERAS, POINTS)
    met = sighted.rays.origins + sighted.distance[:, None] * sighted.rays.directions
    np.testing.assert_allclose(met, XYZ[[0, 0, 1, 2, 2]], atol=1e-6)
    np.testing.assert_allclose(sighted.rays.origins[1], CAMERAS[1].centre, atol=1e-6)
    some = SightLines.of(CAMERAS, POINTS, POINTS.track_frame == 0)
    assert len(some) == 2
    assert torch.equal(some.distance, sighted.distance[[0, 3]])


def test_draws_follow_the_generator_and_join_other_rays() -> None:
    sighted = SightLines.of(CAMERAS, POINTS)
    drawn, again = (sighted.draw(40, torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(drawn.distance, again.distance)
    assert set(drawn.distance.tolist()) == set(sighted.distance.tolist())
    both = join_rays([drawn.rays, again.rays])
    assert both.view is not None
    assert both.shape == (80,)


def test_a_point_in_a_cameras_centre_says_nothing_and_breaks_nothing() -> None:
    points = POINTS.select([True, False, False])
    points.xyz[0] = CAMERAS[0].centre
    sighted = SightLines.of(CAMERAS, points)
    assert torch.isfinite(sighted.rays.directions).all()
    assert sighted.distance[0] < 1e-6


def test_opacity_grows_evenly_within_an_interval() -> None:
    weights = torch.tensor([[0.1, 0.2, 0.4, 0.0]])
    distance = torch.tensor([0.25, 0.9, 1.0, 5.0])
    found = opacity_before(weights.expand(4, -1), TDIST.expand(4, -1), distance)
    assert found.tolist() == pytest.approx([0.05, 0.3, 0.5, 0.7])


@pytest.mark.parametrize(
    ("weights", "loss"),
    [
        ((0.0, 0.0, 1.0, 0.0), 0.0),  # at the point
        ((0.3, 0.0, 0.7, 0.0), 0.3),  # fog on the way
        ((0.0, 0.0, 0.0, 1.0), 1.0),  # through it
        ((0.0, 0.0, 0.0, 0.0), 1.0),  # nothing is met
        ((1.0, 0.0, 0.0, 0.0), 1.0),  # a floater
    ],
)
def test_light_is_to_stop_at_the_point_and_nowhere_before(weights: tuple[float, ...], loss: float) -> None:
    rendering = seen(*weights)
    found = line_of_sight_loss(rendering, slice(0, 1), torch.tensor([1.0]), tolerance=0.1)
    assert found.item() == pytest.approx(loss, abs=1e-6)
    found.backward()
    # Before the point less, at it more; each as strongly as the other, however wrong they are.
    assert rendering.weights.grad is not None
    assert rendering.weights.grad.tolist()[0] == pytest.approx([0.0, 0.0, -1.0, 0.0], abs=1e-5)
