"""Our figures against other implementations', hard inputs included: scikit-image, torchmetrics, torch-fidelity."""

import math

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from torch_fidelity.metric_fid import KEY_METRIC_FID, fid_features_to_statistics, fid_statistics_to_metric
from torch_fidelity.metric_kid import mmd2
from torchmetrics.functional.image import peak_signal_noise_ratio as torchmetrics_psnr
from torchmetrics.functional.image import structural_similarity_index_measure as torchmetrics_ssim

from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.ssim import ssim
from inpaint3d.stages.evaluation.frechet import estimate_kernel_distance, frechet_distance

SHAPES = [(48, 37, 3), (11, 11, 3), (12, 64, 3)]


def pair(kind: str, shape: tuple[int, int, int] = (48, 37, 3)) -> tuple[np.ndarray, np.ndarray]:
    """A picture and a truth, float32 in [0, 1]."""
    rng = np.random.default_rng(3)
    truth = rng.random(shape, dtype=np.float32)
    picture = {
        "noisy": np.clip(truth + rng.normal(0, 0.05, shape), 0, 1),
        "other": rng.random(shape),
        "constant": np.full(shape, 0.5),
        "black": np.zeros(shape),
        "identical": truth,
    }[kind]
    return picture.astype(np.float32), np.full_like(truth, 0.25) if kind == "constant" else truth


def as_batch(picture: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(picture.transpose(2, 0, 1).astype(np.float64))[None]


@pytest.mark.parametrize("shape", [*SHAPES, (3, 5, 3), (1, 1, 3)])
@pytest.mark.parametrize("kind", ["noisy", "other", "constant", "black"])
def test_psnr_is_scikit_images_and_torchmetrics(kind, shape):
    picture, truth = pair(kind, shape)
    found = psnr(picture, truth)
    assert found == pytest.approx(peak_signal_noise_ratio(truth, picture, data_range=1.0), rel=1e-6)
    assert found == pytest.approx(
        float(torchmetrics_psnr(as_batch(picture), as_batch(truth), data_range=1.0)), rel=1e-6
    )


def test_psnr_of_identical_pictures_is_infinite_as_theirs():
    picture, truth = pair("identical")
    assert psnr(picture, truth) == math.inf
    assert float(torchmetrics_psnr(as_batch(picture), as_batch(truth), data_range=1.0)) == math.inf


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", ["noisy", "other", "constant", "black", "identical"])
def test_ssim_is_scikit_images(kind, shape):
    picture, truth = pair(kind, shape)
    theirs = structural_similarity(
        picture.astype(np.float64), truth.astype(np.float64), data_range=1.0, channel_axis=-1,
        gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    )  # fmt: skip
    assert ssim(picture, truth) == pytest.approx(float(theirs), abs=1e-12)


@pytest.mark.parametrize("kind", ["noisy", "other", "constant", "black", "identical"])
def test_ssim_is_torchmetrics(kind):
    """Over the pixels whose whole window lies in the picture: at the border torchmetrics reflects."""
    picture, truth = pair(kind)
    _, values = torchmetrics_ssim(as_batch(picture), as_batch(truth), data_range=1.0, return_full_image=True)
    assert ssim(picture, truth) == pytest.approx(float(values[..., 5:-5, 5:-5].mean()), abs=1e-9)


def features(n: int, d: int, seed: int, shift: float = 0.0) -> np.ndarray:
    """Like pooled activations: none below 0, and correlated."""
    rng = np.random.default_rng(seed)
    mixing = np.random.default_rng(99).normal(size=(d, d)) / np.sqrt(d)
    return np.abs(rng.normal(size=(n, d)) @ mixing + shift)


@pytest.mark.parametrize(("n", "d"), [(400, 48), (60, 48), (20, 64), (6, 128)])
@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_frechet_distance_is_torch_fidelitys(n, d, shift):
    """Also with fewer pictures than dimensions, where the covariances are rank deficient."""
    a, b = features(n, d, 0), features(n, d, 1, shift)
    theirs = fid_statistics_to_metric(*(fid_features_to_statistics(torch.from_numpy(x)) for x in (a, b)), verbose=False)
    assert frechet_distance(a, b) == pytest.approx(theirs[KEY_METRIC_FID], abs=1e-3)


@pytest.mark.parametrize(("n", "d"), [(50, 16), (6, 128), (2, 8)])
def test_kernel_distance_is_torch_fidelitys(n, d):
    a, b = features(n, d, 0), features(n, d, 1, 0.3)
    gram = [(x @ y.T / d + 1) ** 3 for x, y in ((a, a), (a, b), (b, b))]
    assert estimate_kernel_distance(a, b).value == pytest.approx(mmd2(*gram), rel=1e-9)


def test_the_kernel_distances_standard_error_is_the_spread_over_fresh_sets():
    """Over many pairs of sets; the jackknife's errors are a little large, the more so the fewer vectors."""
    rng = np.random.default_rng(0)
    sets = [(rng.normal(size=(30, 2)), rng.normal(size=(30, 2)) + 0.5) for _ in range(300)]
    found = [estimate_kernel_distance(a, b) for a, b in sets]
    told = np.sqrt(np.mean([e.standard_error**2 for e in found]))
    assert told == pytest.approx(np.std([e.value for e in found]), rel=0.2)


def test_two_vectors_have_no_standard_error():
    assert estimate_kernel_distance(features(2, 4, 0), features(5, 4, 1)).standard_error is None
