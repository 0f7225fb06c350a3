import numpy as np
import pytest
import torch

from inpaint3d.perception import lpips
from inpaint3d.stages.evaluation.features import WIDTH, lite0_features
from inpaint3d.stages.evaluation.frechet import kernel_distance


def stripes(seed: int, period: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    _, x = np.mgrid[:40, :50]
    wave = 0.5 + 0.4 * np.sin(2 * np.pi * (x + rng.integers(period)) / period)
    return np.clip(wave[..., None] + rng.normal(0, 0.03, (40, 50, 3)), 0, 1).astype(np.float32)


def test_features_tell_kinds_of_pictures_apart():
    fine = lite0_features([stripes(s, 4) for s in range(4)])
    coarse = lite0_features([stripes(s, 20) for s in range(4)])
    more_fine = lite0_features([stripes(s, 4) for s in range(10, 14)])
    assert fine.shape == (4, WIDTH)
    assert kernel_distance(fine, coarse) > 3 * abs(kernel_distance(fine, more_fine))


def test_no_picture_gives_no_row():
    assert lite0_features([]).shape == (0, WIDTH)


@pytest.mark.parametrize("side", [40, 96])
def test_figures_are_the_same_for_any_number_of_threads(side):
    rng = np.random.default_rng(side)
    pictures = [rng.random((side, side + 7, 3)).astype(np.float32) for _ in range(2)]
    found = []
    before = torch.get_num_threads()
    for threads in (1, 2):
        torch.set_num_threads(threads)
        figures = [lpips.load(network).distance(*pictures) for network in ("vgg", "alex")]
        found.append((lite0_features(pictures).tobytes(), figures, kernel_distance(*[lite0_features(pictures)] * 2)))
        assert torch.get_num_threads() == threads
    torch.set_num_threads(before)
    assert found[0] == found[1]
