import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from inpaint3d.perception import lpips
from inpaint3d.scene.image_io import read_image

REFERENCE = "INPAINT3D_LPIPS_REFERENCE"


def waves(phase: float, height: int = 72, width: int = 80) -> np.ndarray:
    y, x = np.mgrid[:height, :width] / 10.0
    return np.stack([0.5 + 0.5 * np.sin(x * (k + 1) + y + phase) for k in range(3)], -1).astype(np.float32)


@pytest.mark.skipif(REFERENCE not in os.environ, reason=f"{REFERENCE} names no folder with upstream's example pictures")
@pytest.mark.parametrize(("network", "expected"), [("alex", (0.7219, 0.1376)), ("vgg", (0.5686, 0.4217))])
def test_upstreams_pair_has_upstreams_distances(network, expected):
    folder = Path(os.environ[REFERENCE])
    truth, *others = (read_image(folder / f"ex_{name}.png") for name in ("ref", "p0", "p1"))
    measured = [lpips.load(network).distance(other, truth) for other in others]
    assert measured == pytest.approx(expected, abs=5e-5)  # published to four decimals


# What this implementation gave when it reproduced upstream's published distances (the test above).
@pytest.mark.parametrize(("network", "expected"), [("alex", (0.0092, 0.170569)), ("vgg", (0.04168, 0.590121))])
def test_generated_pictures_keep_their_distances(network, expected):
    measured = lpips.load(network).distances([waves(0.3), waves(2.0)], waves(0.0))
    assert measured == pytest.approx(expected, rel=1e-4)  # convolutions sum in another order on other CPUs


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_a_picture_is_at_distance_zero_from_itself_and_symmetric_from_others(network):
    net = lpips.load(network)
    a, b = waves(0.0), waves(1.0)
    assert net.distance(a, a) == 0.0
    assert net.distance(a, b) == pytest.approx(net.distance(b, a), rel=1e-5)


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_crops_of_a_few_pixels_have_a_distance(network):
    net = lpips.load(network)
    small, other = waves(0.0, 9, 14), waves(2.0, 9, 14)
    assert net.distance(small, other) > 0.01


def test_black_pictures_have_finite_features():
    assert lpips.load("vgg").distance(np.zeros((64, 64, 3), np.float32), np.ones((64, 64, 3), np.float32)) > 0.1


def test_a_file_of_weights_that_holds_code_is_refused():
    class Harm:
        def __reduce__(self):
            return (print, ("code ran",))

    with pytest.raises(pickle.UnpicklingError, match="not allowed"):
        lpips.read_arrays(pickle.dumps({"weights": Harm()}))


def test_a_pickle_of_arrays_is_read():
    arrays = {"a": {"b": {"kernel": np.arange(6, dtype=np.float32).reshape(2, 3)}}}
    read = lpips.read_arrays(pickle.dumps(arrays, protocol=3))
    np.testing.assert_array_equal(read["a"]["b"]["kernel"], arrays["a"]["b"]["kernel"])
