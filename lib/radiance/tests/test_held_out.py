import math

import numpy as np
import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.fields import RadianceField, Samples
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.scene.cameras import Camera, look_at

GRID = GridSpec(levels=1, coarsest=4, finest=4, log2_table=8, channels=1)
SPEC = FieldSpec(
    grid=GRID, proposal_grid=GRID, proposal_samples=(8,), samples=8, density_width=8, bottleneck=3, view_width=8,
    view_layers=1, near=0.05, far=100.0,
)  # fmt: skip
CAMERA = Camera(60, 60, 20, 15, 40, 30, look_at((0.9, 0.2, 0.3), (0, 0, 0)))


class Grey(RadianceField):
    """Opaque mid grey everywhere."""

    def query(
        self,
        points: torch.Tensor,
        towards: torch.Tensor,
        appearance: torch.Tensor | None = None,
        specular_scale: float = 1.0,
    ) -> Samples:
        grey = torch.full((len(points), 3), 0.5)
        return Samples(torch.full((len(points),), 1e4), grey, grey)


def photo(offset: float, known: np.ndarray | None = None) -> KnownPhoto:
    """Off by `offset` where it is known, and by far more elsewhere."""
    known = np.ones((30, 40), bool) if known is None else known
    image = np.where(known[..., None], 0.5 + offset, 9.0).repeat(3, -1).astype(np.float32)
    return KnownPhoto(CAMERA, image, known)


def half() -> np.ndarray:
    known = np.zeros((30, 40), bool)
    known[:, 20:] = True
    return known


@pytest.mark.parametrize("make", [HeldOut.on_lattice, HeldOut.at_random])
def test_the_score_is_the_mean_over_photos_of_their_known_pixels_psnr(make) -> None:
    photos = [photo(0.1), photo(0.01, half()), photo(0.3, np.zeros((30, 40), bool))]
    # 20 and 40 dB; the third photo has nothing to be judged by.
    assert make(photos, 10, "cpu").psnr(Grey(SPEC, 0), 7) == pytest.approx(30, abs=1e-3)


@pytest.mark.parametrize("make", [HeldOut.on_lattice, HeldOut.at_random])
def test_a_photo_that_the_field_equals_is_not_in_the_mean(make) -> None:
    held_out = make([photo(0.1), photo(0.0)], 10, "cpu")
    assert held_out.psnr_of_each(Grey(SPEC, 0), 7) == [pytest.approx(20, abs=1e-3), math.inf]
    assert held_out.psnr(Grey(SPEC, 0), 7) == pytest.approx(20, abs=1e-3)
    assert make([photo(0.0)], 10, "cpu").psnr(Grey(SPEC, 0), 7) is None


@pytest.mark.parametrize("make", [HeldOut.on_lattice, HeldOut.at_random])
def test_without_known_pixels_there_is_no_score(make) -> None:
    assert make([], 10, "cpu").psnr(Grey(SPEC, 0), 7) is None
    assert make([photo(0.1, np.zeros((30, 40), bool))], 10, "cpu").psnr(Grey(SPEC, 0), 7) is None


def test_the_choice_at_random_is_always_the_same() -> None:
    rng = np.random.default_rng(3)
    noisy = KnownPhoto(CAMERA, rng.random((30, 40, 3), np.float32), half())
    scores = {HeldOut.at_random([noisy], 50, "cpu").psnr(Grey(SPEC, 0), 64) for _ in range(2)}
    assert len(scores) == 1
    every = HeldOut.at_random([noisy], 10_000, "cpu").psnr(Grey(SPEC, 0), 64)
    truth = -10 * np.log10(np.square(noisy.image[half()] - 0.5).mean())
    assert every == pytest.approx(truth, abs=1e-3), "all known pixels where they are fewer"


def test_the_lattice_has_about_the_pixels_that_are_asked_for() -> None:
    image = np.full((30, 40, 3), 9.0, np.float32)
    image[1::4, 1::4] = 9.0
    image[2::4, 2::4] = 0.6
    assert HeldOut.on_lattice([KnownPhoto(CAMERA, image, np.ones((30, 40), bool))], 10, "cpu").psnr(
        Grey(SPEC, 0), 64
    ) == pytest.approx(20, abs=1e-3)
