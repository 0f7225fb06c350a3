import numpy as np
import torch

from inpaint3d.radiance.rays import CameraStack, camera_rays
from inpaint3d.scene.cameras import Camera, look_at

CAMERAS = [
    Camera(50, 55, 21, 17, 40, 30, look_at((0.8, 0.1, 0.4), (0, 0, 0))),
    Camera(70, 65, 18, 16, 40, 30, look_at((-0.3, 0.7, 0.5), (0, 0, 0.1))),
]


def test_rays_meet_the_points_that_project_onto_their_pixels() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.2, 0.2, (50, 3))
    for camera in CAMERAS:
        xy, z = camera.project(points)
        rays = camera_rays(camera, xy)
        distance = torch.from_numpy(z) / (rays.directions.double() @ torch.from_numpy(camera.forward.copy()))
        met = rays.origins + distance[:, None] * rays.directions
        torch.testing.assert_close(met, torch.from_numpy(points), atol=1e-6, rtol=0)  # rays are float32


def test_a_stack_of_cameras_gives_each_pixel_its_own_cameras_ray() -> None:
    stack = CameraStack.of(CAMERAS)
    view = torch.tensor([0, 1, 1, 0])
    xy = torch.tensor([[0.5, 0.5], [39.5, 29.5], [3.0, 8.0], [20.0, 15.0]])
    together = stack.rays(view, xy)
    for i, index in enumerate(view.tolist()):
        alone = camera_rays(CAMERAS[index], xy[i : i + 1])
        torch.testing.assert_close(together.origins[i], alone.origins[0])
        torch.testing.assert_close(together.directions[i], alone.directions[0])
    lengths = torch.linalg.vector_norm(together.directions, dim=-1)
    torch.testing.assert_close(lengths, torch.ones(4))


def test_all_pixels_come_in_the_picture_s_shape() -> None:
    rays = camera_rays(CAMERAS[0], view=1)
    assert rays.shape == (30, 40)
    assert rays.view is not None
    assert (rays.view == 1).all()
    assert rays.flatten()[100:200].shape == (100,)
    torch.testing.assert_close(rays.directions[3, 7], camera_rays(CAMERAS[0], torch.tensor([[7.5, 3.5]])).directions[0])
