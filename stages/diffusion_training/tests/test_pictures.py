import numpy as np
import pytest

from inpaint3d.stages.diffusion_training.config import MaskMix
from inpaint3d.stages.diffusion_training.pictures import Cropper, KnownPicture, mask_shapes


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
