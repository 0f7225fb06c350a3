from dataclasses import replace

import numpy as np
import torch

from inpaint3d.radiance.line_of_sight import SightLines
from inpaint3d.radiance.rays import camera_rays
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.stages.joint_optimization.batch import Filled, RayBank


def views_of(room: SyntheticScene) -> list[MaskedView]:
    return [
        MaskedView(n, c, np.where(m[..., None], 0, i).astype(np.float32), m, ~m)
        for n, c, i, m in zip(room.names, room.cameras, room.images, room.object_masks, strict=True)
    ]


def test_random_rays_are_uniform_over_known_and_masked_pixels(room: SyntheticScene) -> None:
    """L2, L7: masked pixels are drawn in their share, and never among those that have a colour to match."""
    bank = RayBank(views_of(room), "cpu")
    batch = bank.draw(2000, patches=0, patch_size=8, generator=torch.Generator().manual_seed(0))
    share = room.object_masks.mean()
    assert len(batch.rays.origins) == 2000
    assert len(batch.target) == 2000 - round(2000 * share)
    assert share > 0.02
    pixels = torch.cat([camera_rays(c).directions.reshape(-1, 3) for c in room.cameras])
    hidden = torch.from_numpy(room.object_masks.reshape(-1))
    owner = torch.arange(len(room.cameras)).repeat_interleave(48 * 36)
    for k in (0, 1, 700, len(batch.target) - 1, len(batch.target), 1999):
        assert batch.rays.view is not None
        own = owner == batch.rays.view[k]
        nearest = (pixels[own] @ batch.rays.directions[k]).argmax()
        assert bool(hidden[own][nearest]) == (k >= len(batch.target))


def test_what_was_filled_is_drawn_in_the_share_that_is_asked(room: SyntheticScene) -> None:
    """In place of masked rays, after the known ones, in the colours of the filled pictures."""
    views = views_of(room)
    filled = [replace(v, image=np.full_like(v.image, 0.1 * (i + 1))) for i, v in enumerate(views)]
    depths = [np.full(m.shape, 2.0 + i) for i, m in enumerate(room.object_masks)]
    surfaces = SightLines.of_surfaces(list(zip(room.cameras, depths, room.object_masks, strict=True)))
    bank = RayBank(views, "cpu", filled=Filled(filled, surfaces), filled_share=0.25)
    batch = bank.draw(400, patches=0, patch_size=8, generator=torch.Generator().manual_seed(0), sighted=16)
    assert len(batch.target) == 400
    assert len(batch.rays.origins) == 416
    assert batch.rays.view is not None
    for k in range(400):
        view = int(batch.rays.view[k])
        (x, y), _ = room.cameras[view].project(room.cameras[view].centre + batch.rays.directions[k].numpy())
        assert room.object_masks[view][int(y), int(x)] == (k >= 300)
        wanted = filled[view] if k >= 300 else views[view]
        np.testing.assert_array_equal(batch.target[k].numpy(), wanted.image[int(y), int(x)])
    assert batch.sighted == slice(400, 416)
    ends = batch.rays.origins[400:] + batch.rays.directions[400:] * batch.distance[:, None]
    for origin, end in zip(batch.rays.origins[400:].numpy(), ends.numpy(), strict=True):
        view = int(np.argmin([np.linalg.norm(c.centre - origin) for c in room.cameras]))
        (x, y), z = room.cameras[view].project(end.astype(np.float64))
        assert room.object_masks[view][int(y), int(x)]
        np.testing.assert_allclose(z, 2.0 + view, rtol=1e-5)


def test_colours_belong_to_their_rays(room: SyntheticScene) -> None:
    bank = RayBank(views_of(room), "cpu")
    batch = bank.draw(50, patches=0, patch_size=8, generator=torch.Generator().manual_seed(1))
    assert batch.rays.view is not None
    for k in range(20):
        camera, image = room.cameras[int(batch.rays.view[k])], room.images[int(batch.rays.view[k])]
        away = batch.rays.directions[k].numpy()
        (x, y), _ = camera.project(camera.centre + away)
        np.testing.assert_array_equal(batch.target[k].numpy(), image[int(y), int(x)])


def test_depth_patches_are_squares_of_neighbouring_pixels_of_one_view(room: SyntheticScene) -> None:
    """L6."""
    bank = RayBank(views_of(room), "cpu")
    batch = bank.draw(10, patches=4, patch_size=5, generator=torch.Generator().manual_seed(2))
    assert batch.patches == (4, 5, 5)
    assert batch.rays.view is not None
    views = batch.rays.view[-100:].reshape(4, 25)
    assert (views == views[:, :1]).all()
    for patch in range(4):
        camera = room.cameras[int(views[patch, 0])]
        away = batch.rays.directions[-100:].reshape(4, 25, 3)[patch].numpy()
        xy = camera.project(camera.centre + away)[0].reshape(5, 5, 2)
        np.testing.assert_allclose(np.diff(xy[..., 0], axis=1), 1, atol=1e-3)
        np.testing.assert_allclose(np.diff(xy[..., 1], axis=0), 1, atol=1e-3)
        assert xy.min() > 0.49
        assert (xy[..., 0] < 48).all()
        assert (xy[..., 1] < 36).all()


def test_without_masks_every_ray_has_a_colour(room: SyntheticScene) -> None:
    plain = [MaskedView(v.name, v.camera, v.image, np.zeros_like(v.hole), v.known | v.hole) for v in views_of(room)]
    batch = RayBank(plain, "cpu").draw(64, patches=1, patch_size=4, generator=torch.Generator().manual_seed(0))
    assert len(batch.target) == 64
