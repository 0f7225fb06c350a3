"""A hole filled by example, on patterns whose continuation is known."""

import numpy as np
import pytest

from inpaint3d.diffusion.fill import fill_telea
from inpaint3d.stages.view_completion.example import PATCH, blend_copies, copy_patches, fill_by_example

SHAPE = (60, 72)


def hole_in_the_middle() -> np.ndarray:
    hole = np.zeros(SHAPE, bool)
    hole[24:38, 28:45] = True
    return hole


def stripes() -> np.ndarray:
    """Six pixels to the period, so that every pixel of it is found elsewhere."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    wave = ((x + 2 * y) % 6 < 3).astype(np.float32)
    return np.stack([wave, 1 - wave, 0.5 * wave], -1)


def copies(image: np.ndarray, hole: np.ndarray, source: np.ndarray) -> np.ndarray:
    made = copy_patches(np.where(hole[..., None], 0, image).astype(np.float32), hole, source)
    assert made is not None
    return made[0]


def test_a_pattern_goes_on() -> None:
    """Stripes are continued, edge for edge, where a smooth filling leaves grey."""
    image, hole = stripes(), hole_in_the_middle()
    blank = np.where(hole[..., None], 0, image).astype(np.float32)
    made = fill_by_example(blank, hole, ~hole)[0]
    error, smooth = (np.abs(some - image)[hole].mean() for some in (made, fill_telea(blank, hole)))
    assert error < 0.05
    assert smooth > 0.2


def test_detail_is_that_of_the_surround() -> None:
    """Noise has nothing to match, yet what is copied keeps its spread."""
    image = np.random.default_rng(0).uniform(size=(*SHAPE, 3)).astype(np.float32)
    hole = hole_in_the_middle()
    made = copies(image, hole, ~hole)
    assert 0.8 < made[hole].std() / image[~hole].std() < 1.2
    # Every pixel of it is a pixel of the source.
    apart = np.abs(made[hole][:, None] - image[~hole][None]).max(-1).min(1)
    assert apart.max() == 0


def test_a_large_hole_is_as_lively_as_what_lies_around_it() -> None:
    """Over three levels, at a size that halves to none of them: copies in one piece, of noise and not of the smooth."""
    rng = np.random.default_rng(2)
    image = np.full((151, 173, 3), 0.5, np.float32) + rng.normal(0, 0.1, (151, 173, 1)).astype(np.float32)
    image[:60, :60] = 0.5
    hole = np.zeros(image.shape[:2], bool)
    hole[50:113, 55:126] = True
    made = copies(image, hole, ~hole)
    steps, known = np.abs(np.diff(made[..., 0], axis=1)), ~hole
    known[:60, :60] = False
    assert steps[hole[:, 1:] & hole[:, :-1]].mean() > 0.8 * steps[known[:, 1:] & known[:, :-1]].mean()
    assert np.isin(made[hole][:, 0], image[~hole][:, 0]).all()


def test_patches_come_from_the_source_alone() -> None:
    """Half of the picture is red, and only the other half may be copied."""
    image = np.random.default_rng(1).uniform(size=(*SHAPE, 3)).astype(np.float32)
    image[:, :36] = (1, 0, 0)
    hole = hole_in_the_middle()
    source = ~hole
    source[:, :36] = False
    made = copies(image, hole, source)
    palette = image[source]
    assert np.abs(made[hole][:, None] - palette[None]).max(-1).min(1).max() == 0


def test_known_pixels_stay_and_the_hole_is_never_looked_at() -> None:
    image, hole = stripes(), hole_in_the_middle()
    marked = np.where(hole[..., None], np.array([1.0, 0.0, 1.0], np.float32), image)
    made = fill_by_example(image, hole, ~hole)[0]
    np.testing.assert_array_equal(made[~hole], image[~hole])
    np.testing.assert_array_equal(made, fill_by_example(marked, hole, ~hole)[0])


def test_what_is_copied_from_the_light_into_shade_is_darkened() -> None:
    """Checks under a light that falls off: copied as they are from the lit side, they are those of the shaded one."""
    y, x = np.mgrid[:60, :96]
    checks = np.where((x // 4 + y // 4) % 2, 0.9, 0.45)
    image = (checks * np.exp(-x / 60))[..., None].repeat(3, -1).astype(np.float32)
    hole = np.zeros(image.shape[:2], bool)
    hole[20:40, 56:80] = True
    origins = np.arange(image[..., 0].size).reshape(hole.shape)
    origins[hole] -= 40
    pieces = np.where(hole[..., None], image.reshape(-1, 3)[origins], image)
    before, after = (np.abs(some - image)[hole].mean() for some in (pieces, blend_copies(pieces, origins, hole)))
    assert before > 0.15
    assert after < 0.2 * before


def test_a_rim_that_the_mask_left_darkens_nothing() -> None:
    """Grey copies beside a black line, the rest of their surround being as grey as they are."""
    picture = np.full((40, 60, 3), 0.6, np.float32)
    hole = np.zeros(picture.shape[:2], bool)
    hole[10:30, 20:40] = True
    picture[10:30, 18:20] = 0.02
    origins = np.arange(hole.size).reshape(hole.shape)
    origins[hole] += 22
    np.testing.assert_allclose(blend_copies(picture, origins, hole)[hole], 0.6, atol=1e-4)


@pytest.mark.parametrize("side", [0, PATCH - 1])
def test_without_a_whole_patch_to_copy_the_hole_is_filled_smoothly(side: int) -> None:
    image, hole = stripes(), hole_in_the_middle()
    source = np.zeros(SHAPE, bool)
    source[:side, :side] = True
    np.testing.assert_array_equal(fill_by_example(image, hole, source)[0], fill_telea(image, hole))


def test_variety_lets_the_seed_choose() -> None:
    """Without it every seed gives the same fill; with it each another, of the same palette."""
    image = np.random.default_rng(2).uniform(size=(*SHAPE, 3)).astype(np.float32)
    hole = hole_in_the_middle()

    def filled(variety: float, seed: int) -> np.ndarray:
        return fill_by_example(image, hole, ~hole, variety=variety, seed=seed)[0]

    np.testing.assert_array_equal(filled(0.0, 0), filled(0.0, 1))
    np.testing.assert_array_equal(filled(1.0, 0), filled(1.0, 0))
    assert np.abs(filled(1.0, 0) - filled(1.0, 1))[hole].mean() > 0.1
