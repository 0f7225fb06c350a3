"""What may fill the hole, each on real views of the synthetic room."""

import numpy as np
import pytest
import torch

from inpaint3d.contracts.models.artifacts import PriorSpec
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.perception.lpips import load
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.scene.windows import Window, choose_fixed_windows, draw_window
from inpaint3d.stages.joint_optimization.feature_guide import FeatureGuide
from inpaint3d.stages.joint_optimization.guidance import DatasetGuide, Guide, PictureGuide
from inpaint3d.stages.joint_optimization.schedule import TimestepRange
from tests.guides import make_prior_guide, prior_estimator

TIMES = TimestepRange(0.4, 0.6, floored=False)
ASKING = ["sds", "nfsd", "sdi", "ism", "vsd", "denoised-target"]


@pytest.fixture(scope="module")
def views(room: SyntheticScene) -> list[MaskedView]:
    return [
        MaskedView(n, c, np.where(m[..., None], 0, i).astype(np.float32), m, ~m)
        for n, c, i, m in zip(room.names, room.cameras, room.images, room.object_masks, strict=True)
    ]


@pytest.fixture
def prior(prior_spec: PriorSpec) -> InpaintingPrior:
    return InpaintingPrior(prior_spec, seed=0)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def window_of(views: list[MaskedView], index: int, size: int) -> Window:
    view = views[index]
    window = draw_window(view.hole, view.known, index, size=size, span=0.7, min_known=0.2, rng=None)
    assert window is not None
    return window


def descended(guide: Guide, patch: torch.Tensor, hole: torch.Tensor, window: Window, steps: int) -> torch.Tensor:
    """The patch after a few steps of Adam along the guide's gradients, which must be 0 outside the hole."""
    x = patch.clone().requires_grad_()
    optimiser, stream = torch.optim.Adam([x], lr=0.05), generator(3)
    for _ in range(steps):
        x.grad, _ = guide.gradient(x.detach().clamp(0, 1), hole, window, TIMES, stream)
        assert (x.grad[~hole] == 0).all()
        optimiser.step()
    return x.detach()


@pytest.mark.parametrize("guidance", [1.0, 3.0])
@pytest.mark.parametrize("estimator", ASKING)
def test_evaluations_are_those_that_are_made(prior: InpaintingPrior, estimator: str, guidance: float) -> None:
    guide = make_prior_guide(estimator, prior, guidance=guidance, steps=3)
    copy = guide.copy
    made: list[int] = []
    for network in [prior.network, *([copy.network.network] if copy else [])]:
        network.register_forward_hook(lambda *_: made.append(1))
    hole = torch.zeros(16, 16, dtype=torch.bool)
    hole[4:9, 4:9] = True
    guide.gradient(torch.rand(16, 16, 3), hole, Window(0, 0.0, 0.0, 1.0, 16), TIMES, generator())
    backward = 2 if copy else 0
    assert len(made) + backward == prior_estimator(estimator, guidance=guidance, steps=3).evaluations()


def test_a_dataset_keeps_its_picture_until_it_is_updated(prior: InpaintingPrior, views: list[MaskedView]) -> None:
    windows = choose_fixed_windows(views, size=16, span=0.7, min_known=0.2)
    guide = DatasetGuide(prior, windows, guidance=1.0, steps=2, update_every=3)
    window = windows[1]
    assert window is not None
    hole, stream = torch.from_numpy(window.sample(views[1].hole)), generator()
    patch = torch.rand(16, 16, 3, generator=generator(1))
    gradients = [guide.gradient(patch, hole, window, TIMES, stream)[0] for _ in range(4)]
    assert torch.equal(gradients[0], gradients[1])
    assert torch.equal(gradients[0], gradients[2])
    assert not torch.equal(gradients[0], gradients[3])
    resumed = DatasetGuide(prior, windows, guidance=1.0, steps=2, update_every=3)
    resumed.restore({name: tensor.clone() for name, tensor in guide.state().items()})
    assert torch.equal(resumed.gradient(patch, hole, window, TIMES, generator(9))[0], gradients[3])


def test_a_picture_pulls_the_hole_by_lpips_alone(room: SyntheticScene, views: list[MaskedView]) -> None:
    """What the field shows outside the hole does not matter; inside, the picture is approached."""
    window = window_of(views, 0, 32)
    hole = torch.from_numpy(window.sample(views[0].hole))
    picture = torch.from_numpy(window.sample(room.empty_images[0])).float()
    guide = PictureGuide([room.empty_images[0]], 32)
    start = torch.where(hole[..., None], 0.5, picture)
    elsewhere = torch.where(hole[..., None], start, 1 - picture)
    one, two = (guide.gradient(x, hole, window, TIMES, generator())[0] for x in (start, elsewhere))
    torch.testing.assert_close(one, two)
    end = descended(guide, start, hole, window, 15)
    before, after = (load("vgg").distance(x.numpy(), picture.numpy()) for x in (start, end))
    assert after < 0.7 * before


@pytest.mark.parametrize("matching", ["nearest", "sliced"])
def test_features_pull_the_hole_to_colours_of_the_scene(
    room: SyntheticScene, views: list[MaskedView], matching: str
) -> None:
    """From a colour that is nowhere in the room, the hole goes towards what the views show around it."""
    window = window_of(views, 0, 32)
    hole = torch.from_numpy(window.sample(views[0].hole))
    truth = torch.from_numpy(window.sample(room.empty_images[0])).float()
    guide = FeatureGuide(views, size=32, matching=matching, reference_windows=2, min_known=0.2)
    strange = torch.tensor([1.0, 0.0, 1.0])
    start = torch.where(hole[..., None], strange, truth)
    end = descended(guide, start, hole, window, 15)
    palette = truth[~hole]
    before, after = (float(torch.cdist(x[hole], palette).min(1).values.mean()) for x in (start, end))
    assert after < 0.6 * before
