"""Views that are filled on their own."""

from dataclasses import replace

import numpy as np
import pytest

from inpaint3d.contracts.models.artifacts.completion import SOURCE_CODES
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.scene.windows import choose_fixed_windows
from inpaint3d.stages.view_completion.classical import complete_classically
from inpaint3d.stages.view_completion.config import PriorSamples
from inpaint3d.stages.view_completion.prior_samples import complete_by_samples, paste_window, sample_window
from tests.room_artifacts import PRIOR

METHOD = PriorSamples(sample_steps=3, span=0.7)


@pytest.fixture(scope="module")
def views(room: SyntheticScene) -> list[MaskedView]:
    return [
        MaskedView(n, c, np.where(m[..., None], 0, i).astype(np.float32), m, ~m)
        for n, c, i, m in zip(room.names, room.cameras, room.images, room.object_masks, strict=True)
    ]


def test_samples_of_one_seed_share_their_noise(views: list[MaskedView]) -> None:
    """E4: the same view twice gives the same picture; another view or another seed another one."""
    prior = InpaintingPrior(PRIOR, seed=0)
    a, b, other = complete_by_samples([views[0], replace(views[0], name="again"), views[1]], prior, METHOD, seed=4)
    (again,) = complete_by_samples(views[:1], prior, METHOD, seed=5)
    np.testing.assert_array_equal(a.picture, b.picture)
    assert np.abs(a.picture - again.picture)[views[0].hole].max() > 0.01
    assert not np.array_equal(a.picture, other.picture)
    np.testing.assert_array_equal(a.picture[views[0].known], views[0].image[views[0].known])


def test_a_pasted_window_is_sampled_back_as_it_was(views: list[MaskedView]) -> None:
    """Every cell of the window that lies on the hole."""
    (window,) = choose_fixed_windows(views[:1], size=16, span=0.7, min_known=0.2)
    assert window is not None
    made = sample_window(views[0], window, InpaintingPrior(PRIOR, seed=0), METHOD, seed=1, device="cpu")
    pasted = paste_window(views[0], window, made)
    inside = window.sample(views[0].hole)
    assert inside.any()
    np.testing.assert_array_equal(window.sample(pasted.picture)[inside], made[inside])
    assert (window.sample(pasted.sources)[inside] == SOURCE_CODES["prior"]).all()


def test_classical_filling_makes_up_masked_pixels_alone(views: list[MaskedView]) -> None:
    for view, filled in zip(views, complete_classically(views), strict=True):
        np.testing.assert_array_equal(filled.picture[view.known], view.image[view.known])
        np.testing.assert_array_equal(filled.sources, np.where(view.hole, SOURCE_CODES["smooth"], 0))
        # Blank before; afterwards of the colours of what surrounds it.
        low, high = view.image[view.known].min(0) - 0.01, view.image[view.known].max(0) + 0.01
        inside = filled.picture[view.hole]
        assert ((inside >= low) & (inside <= high)).all()
