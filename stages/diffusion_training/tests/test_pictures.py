import cv2
import numpy as np
import pytest
import torch

from inpaint3d.scene.image_io import read_image, write_png
from inpaint3d.stages.diffusion_training.config import MaskMix
from inpaint3d.stages.diffusion_training.pictures import Cropper, KnownPicture, StoredPicture, mask_shapes


def _picture(unknown: np.ndarray, marker: float = 0.0) -> KnownPicture:
    colour = np.random.default_rng(0).uniform(-1, 1, (*unknown.shape, 3)).astype(np.float32)
    colour[unknown] = marker
    return KnownPicture("frame", colour, unknown, unknown)


def _disc(height: int, width: int, radius: float) -> np.ndarray:
    y, x = np.mgrid[:height, :width]
    return (y - height / 2) ** 2 + (x - width / 2) ** 2 < radius**2


def test_a_pixel_that_touches_the_unknown_is_in_the_hole_and_not_taught() -> None:
    """Marked with NaN, anything averaged with an unknown pixel would show itself."""
    picture = _picture(_disc(90, 120, 25), marker=np.nan)
    cropper = Cropper(32, (0.4, 1.0), MaskMix(), mask_shapes([picture]))
    batch = cropper.batch([picture] * 40, np.random.default_rng(1))
    taught = batch.teach.expand_as(batch.image) > 0
    assert batch.image[taught].isfinite().all()
    assert (~taught).any()
    # Known to nobody: inside the hole wherever it is not taught.
    assert (batch.hole[batch.teach == 0] == 1).all()


def test_crops_come_at_several_scales_and_keep_the_range() -> None:
    picture = _picture(np.zeros((64, 96), bool))
    ramp = KnownPicture("ramp", np.linspace(-1, 1, 96, dtype=np.float32)[None, :, None].repeat(64, 0).repeat(3, 2),
                        picture.unknown, picture.hole)  # fmt: skip
    batch = Cropper(16, (0.25, 1.0), MaskMix(rectangles=1, strokes=0, blobs=0, own=0), []).batch(
        [ramp] * 60, np.random.default_rng(0)
    )
    slope = (batch.image[:, 0, 0, -1] - batch.image[:, 0, 0, 0]).abs()
    # A ramp's rise over the crop is the crop's side: from a quarter of the short side to all of it, 64 of 96 columns.
    assert slope.min() < 0.45
    assert slope.max() > 1.0
    assert batch.image.abs().max() <= 1


def test_frames_smaller_than_the_prior_are_enlarged() -> None:
    batch = Cropper(32, (0.5, 1.0), MaskMix(), []).batch([_picture(np.zeros((20, 30), bool))], np.random.default_rng(0))
    assert batch.image.shape == (1, 3, 32, 32)


def test_a_small_share_is_a_crop_of_the_enlarged_frame() -> None:
    """The paper crops 256 of 1080 rows of frames of 720 (D2, D3): here 24 of 90 rows, of frames of 60."""
    y, x = np.mgrid[:60, :80] / 60
    smooth = np.stack([np.sin(5 * x), np.cos(4 * y), np.sin(3 * (x + y))], -1).astype(np.float32)
    picture = KnownPicture("frame", smooth, np.zeros((60, 80), bool), np.zeros((60, 80), bool))
    enlarged = cv2.resize(smooth, (120, 90), interpolation=cv2.INTER_LINEAR)
    windows = np.lib.stride_tricks.sliding_window_view(enlarged, (24, 24), axis=(0, 1)).transpose(0, 1, 3, 4, 2)
    mix = MaskMix(rectangles=1, strokes=0, blobs=0, own=0)
    for crop in (
        Cropper(24, (24 / 90, 24 / 90), mix, [], enlarged=1.5).batch([picture] * 8, np.random.default_rng(0)).image
    ):
        rows = crop.permute(1, 2, 0).numpy()
        distances = [np.abs(windows - either).mean(axis=(2, 3, 4)).min() for either in (rows, rows[:, ::-1])]
        # A frame pixel is 1.5 enlarged ones, so that the nearest window may lie half a pixel off, where the smooth
        # picture is 0.02 another on average.
        assert min(distances) < 0.025


def test_whole_crops_are_the_largest_square_of_the_frame() -> None:
    ramp = np.linspace(-1, 1, 60, dtype=np.float32)[:, None, None].repeat(60, 1).repeat(3, 2)
    picture = KnownPicture("ramp", ramp, np.zeros((60, 60), bool), np.zeros((60, 60), bool))
    mix = MaskMix(rectangles=1, strokes=0, blobs=0, own=0)
    batch = Cropper(12, (0.2, 0.2), mix, [], whole_share=0.5).batch([picture] * 200, np.random.default_rng(0))
    rise = batch.image[:, 0, -1, 0] - batch.image[:, 0, 0, 0]
    # From the middle of the outermost pixel to that of the other: 55 of 59 rows or 11.
    assert set(rise.mul(59 / 2).round(decimals=3).tolist()) == {11, 55}
    # 200 draws of a half: within 3.5 standard deviations.
    assert 75 < int((rise > 1).sum()) < 125


def test_a_stored_picture_is_read_when_it_is_drawn(tmp_path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (40, 40, 3), np.uint8)
    stored = StoredPicture("a", tmp_path / "a.png")
    write_png(stored.path, image)
    batch = Cropper(40, (1.0, 1.0), MaskMix(), []).batch([stored] * 8, np.random.default_rng(0))
    expected = image / 127.5 - 1
    for drawn in batch.image.permute(0, 2, 3, 1).numpy():
        assert any(np.allclose(drawn, either, atol=1e-6) for either in (expected, expected[:, ::-1]))
    assert batch.teach.min() == 1


def test_cutting_before_converting_gives_the_same_bits(tmp_path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (50, 70, 3), np.uint8)
    stored = StoredPicture("a", tmp_path / "a.png")
    write_png(stored.path, image)
    nothing = np.zeros(image.shape[:2], bool)
    whole = KnownPicture("a", read_image(stored.path) * 2 - 1, nothing, nothing)
    cropper = Cropper(16, (0.3, 1.0), MaskMix(own=0, blobs=0.6), [])
    one, other = (cropper.batch([picture] * 8, np.random.default_rng(1)) for picture in (stored, whole))
    assert stored.read().colour.dtype == np.uint8
    assert torch.equal(one.image, other.image)
    assert torch.equal(one.hole, other.hole)


def test_the_captures_own_shapes_appear_elsewhere() -> None:
    unknown = np.zeros((60, 80), bool)
    unknown[25:35, 20:60] = True
    shapes = mask_shapes([_picture(unknown)])
    assert [shape.shape for shape in shapes] == [(10, 40)]
    cropper = Cropper(32, (0.5, 1.0), MaskMix(rectangles=0, strokes=0, blobs=0, own=1), shapes)
    holes = cropper.batch([_picture(np.zeros((60, 80), bool))] * 200, np.random.default_rng(0)).hole.numpy()[:, 0] > 0
    # A bar four times as long as high, cut by the border or not, is never higher than a quarter of 0.75 x 32.
    assert max(hole.any(axis=1).sum() for hole in holes) <= 7
    assert max(hole.any(axis=0).sum() for hole in holes) >= 20
    assert holes.any(axis=0).all()


@pytest.mark.parametrize("share", [0.0, 0.9])
def test_masks_of_almost_nothing_or_everything_lend_no_shape(share: float) -> None:
    unknown = np.zeros((40, 40), bool)
    unknown[: int(40 * share)] = True
    assert mask_shapes([_picture(unknown)]) == []
