"""What splats are fitted to, and that they come nearer to it, on the synthetic room."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from inpaint3d.contracts.errors import BadInputError, NonFiniteError
from inpaint3d.contracts.models.artifacts import CompletedView, CompletedViews
from inpaint3d.contracts.store import FolderStore
from inpaint3d.radiance.surface_views import SurfaceView
from inpaint3d.scene.colour import to_bytes
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.map_io import write_codes
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.splat_export.fit import Schedule, fit, mean_ssim, measure_loss
from inpaint3d.stages.splat_export.run import draw
from inpaint3d.stages.splat_export.start import begin
from inpaint3d.stages.splat_export.targets import Target, load_targets

ROOM = synthetic_scene(views=4)
HOW = Schedule(steps=24, position_rate=2e-3, similarity=0.2, seed=0)


def targets():
    everywhere = np.ones(ROOM.images.shape[1:3], bool)
    seen = zip(ROOM.names, ROOM.cameras, ROOM.empty_images, strict=True)
    return [Target(name, camera, to_bytes(image), everywhere) for name, camera, image in seen]


def start():
    seen = zip(ROOM.cameras, ROOM.empty_images, ROOM.empty_depths, strict=True)
    surfaces = [SurfaceView(camera, image, depth.astype(np.float32)) for camera, image, depth in seen]
    return begin(surfaces, list(ROOM.empty_images), 1500)


def error(cloud):
    return -np.mean([psnr(draw(cloud, target.camera), target.picture) for target in targets()])


def silent(step, loss):
    pass


def test_pictures_come_nearer_to_the_targets():
    before, losses = start(), []
    after = fit(before, targets(), HOW, lambda step, loss: losses.append((step, loss)))
    assert error(after) < error(before) - 3
    assert [step for step, _ in losses] == list(range(1, 25))
    assert after.rgb.min() >= 0
    assert after.rgb.max() <= 1


def test_the_same_bytes_for_any_number_of_threads_and_others_for_another_seed():
    found, before = [], torch.get_num_threads()
    for threads, seed in ((1, 0), (2, 0), (2, 1)):
        torch.set_num_threads(threads)
        found.append(fit(start(), targets(), Schedule(5, 2e-3, 0.2, seed), silent).mean.tobytes())
    torch.set_num_threads(before)
    assert found[0] == found[1] != found[2]


def test_pixels_that_do_not_count_move_nothing():
    counts = np.zeros(ROOM.images.shape[1:3], bool)
    nothing = [Target(t.name, t.camera, t.codes, counts) for t in targets()]
    before = start()
    after = fit(before, nothing, Schedule(3, 2e-3, 0.2, 0), silent)
    for name, array in before.arrays.items():
        np.testing.assert_array_equal(after.arrays[name], array)


def test_splats_that_are_not_finite_are_refused():
    broken = start()
    broken.rgb[3] = np.nan
    with pytest.raises(NonFiniteError, match="rgb"):
        fit(broken, targets(), Schedule(1, 2e-3, 0.0, 0), silent)


def test_ssim_of_every_window_is_the_published_one():
    x, y = (torch.from_numpy(image) for image in (ROOM.images[0], ROOM.images[1]))
    _, every = structural_similarity(
        x.numpy(), y.numpy(), win_size=7, use_sample_covariance=False, channel_axis=-1, data_range=1.0, full=True
    )
    truth = every[3:-3:3, 3:-3:3].mean()
    assert mean_ssim(x, y).item() == pytest.approx(truth, abs=1e-5)
    assert mean_ssim(x[:2, :2], x[:2, :2]).item() == pytest.approx(1)


def test_the_loss_is_l1_and_ssim_by_their_weights():
    x, y = (torch.from_numpy(image) for image in (ROOM.images[0], ROOM.images[1]))
    counts = torch.ones(x.shape[:2], dtype=torch.bool)
    both = measure_loss(x, y, counts, 0.25).item()
    assert both == pytest.approx(0.75 * (x - y).abs().mean().item() + 0.25 * (1 - mean_ssim(x, y).item()), abs=1e-6)
    assert measure_loss(x, y, ~counts, 0.25).item() == pytest.approx(0, abs=1e-6)


def masked():
    seen = zip(ROOM.names, ROOM.cameras, ROOM.images, ROOM.object_masks, strict=True)
    return [
        MaskedView(name, camera, np.where(hole[..., None], 0, image).astype(np.float32), hole, ~hole)
        for name, camera, image, hole in seen
    ]


def completed(folder, pictures):
    store = FolderStore(folder)
    made, views = store.private_folder(), []
    for name, picture in zip(ROOM.names, pictures, strict=True):
        write_png(made / "pictures" / f"{name}.png", picture)
        write_codes(made / "sources" / f"{name}.png", np.zeros(picture.shape[:2], np.uint16))
        views.append(CompletedView(name=name, picture=f"pictures/{name}.png", sources=f"sources/{name}.png"))
    digest = store.put(made, "completed-views", CompletedViews(method="classical", summary="", views=tuple(views)))
    return store.open(digest, CompletedViews)


def test_targets_are_photos_outside_the_mask_and_completed_inside(tmp_path):
    made = completed(tmp_path, np.full_like(ROOM.images, 0.25))
    for target, view in zip(load_targets(masked(), made, None, 4096), masked(), strict=True):
        np.testing.assert_array_equal(target.codes[view.known], to_bytes(view.image)[view.known])
        assert (target.codes[view.hole] == 64).all()
        assert target.counts.all()


def test_completed_views_of_another_size_are_refused(tmp_path):
    with pytest.raises(BadInputError, match="24 x 18 pixels, its photo 48 x 36"):
        load_targets(masked(), completed(tmp_path, ROOM.images[:, ::2, ::2]), None, 4096)


def test_a_view_without_a_picture_of_its_hole_is_refused():
    with pytest.raises(BadInputError, match="has not been completed"):
        load_targets(masked(), None, None, 4096)
