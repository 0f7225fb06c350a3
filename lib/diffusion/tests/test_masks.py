import numpy as np
import pytest

from inpaint3d.diffusion.masks import STANDARD_MIX, blobs, random_masks, rectangles, strokes


def test_no_mask_is_empty_and_none_leaves_nothing_known() -> None:
    for mix in (STANDARD_MIX, {"rectangles": 0.5, "strokes": 0.5}):
        shares = random_masks(300, 64, np.random.default_rng(0), mix).mean(axis=(1, 2))
        assert shares.min() > 0.01
        assert shares.max() < 0.95


def test_strokes_cover_more_than_rectangles_and_all_kinds_vary() -> None:
    rng = np.random.default_rng(0)
    share = {kind: np.array([kind(64, rng).mean() for _ in range(200)]) for kind in (rectangles, strokes, blobs)}
    assert share[strokes].mean() > share[rectangles].mean()
    assert all(s.std() > 0.05 for s in share.values())


def test_holes_fall_everywhere() -> None:
    hits = random_masks(600, 32, np.random.default_rng(0)).mean(axis=0)
    assert hits.min() > 0.05


def test_the_same_generator_draws_the_same_masks() -> None:
    one, same, other = (random_masks(8, 32, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("mix", [{"rectangles": 0.5}, {"triangles": 1.0}])
def test_a_mix_that_cannot_be_drawn_is_refused(mix) -> None:
    with pytest.raises(ValueError, match="kinds are"):
        random_masks(1, 32, np.random.default_rng(0), mix)


@pytest.mark.parametrize("size", [1, 2, 8])
def test_strokes_are_a_pixel_thick_at_least(size: int) -> None:
    assert all(strokes(size, np.random.default_rng(seed)).any() for seed in range(30))
