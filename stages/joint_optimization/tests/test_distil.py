"""Rows S2 to S5 and L8, on a real field and a real (untrained) prior."""

import numpy as np
import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec, PriorSpec
from inpaint3d.diffusion.distillation import PriorQuery, sds_gradient
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rays import Rays, camera_rays
from inpaint3d.radiance.rendering import render
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.scene.windows import Window
from inpaint3d.stages.joint_optimization.distil import Distilled, distil
from inpaint3d.stages.joint_optimization.guidance import PictureGuide, PriorGuide
from inpaint3d.stages.joint_optimization.schedule import TimestepRange
from tests.guides import make_prior_guide

TIMES = TimestepRange(0.3, 0.5, floored=False)
WINDOW = Window(0, 8.0, 2.0, 2.0, 16)
SPEC = FieldSpec(
    grid=GridSpec(levels=3, coarsest=4, finest=32, log2_table=10, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=10, channels=1),
    proposal_samples=(8,), samples=8, density_width=8, bottleneck=4, view_width=8, view_layers=1, glo=2, glo_views=3,
    contraction=False, bound=2.0, far=5.0,
)  # fmt: skip


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture
def field() -> RadianceField:
    # The shipped start is empty space; the weights of the stub's kind are a visible, grey fog.
    field = RadianceField(SPEC, seed=0)
    with torch.no_grad():
        for parameter in field.parameters():
            parameter.add_(0.3 * torch.randn(parameter.shape, generator=generator(7)))
    return field


@pytest.fixture
def prior(prior_spec: PriorSpec) -> InpaintingPrior:
    prior = InpaintingPrior(prior_spec, seed=0)
    # A fresh network answers 0 whatever it is shown; this one has opinions.
    with torch.no_grad():
        for parameter in prior.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, generator=generator(3)))
    return prior


@pytest.fixture(params=["sds", "nfsd", "sdi", "ism", "denoised-target"])
def guide(request: pytest.FixtureRequest, prior: InpaintingPrior) -> PriorGuide:
    return make_prior_guide(request.param, prior, guidance=2.0, steps=2)


@pytest.fixture
def view(room: SyntheticScene) -> MaskedView:
    hole = room.object_masks[0]
    return MaskedView("a", room.cameras[0], np.where(hole[..., None], 0, room.images[0]), hole, ~hole)


def distilled(field: RadianceField, guide: PriorGuide, view: MaskedView, **changes: object) -> Distilled:
    settings = {
        "timesteps": TimestepRange(0.3, 0.5, False),
        "specular_scale": 1.0,
        "block": 4096,
        "generator": generator(),
    } | changes
    return distil(field, guide, view, WINDOW, **settings)  # pyright: ignore[reportArgumentType]


def gradients(field: RadianceField, of: torch.Tensor) -> list[torch.Tensor]:
    got = torch.autograd.grad(of, list(field.parameters()), allow_unused=True, retain_graph=True)
    return [torch.zeros(()) if g is None else g for g in got]


def test_gradient_is_zero_outside_the_hole(guide: PriorGuide) -> None:
    """S4: the prior moves the hole alone."""
    patch, hole = torch.rand(16, 16, 3, generator=generator()), torch.zeros(16, 16, dtype=torch.bool)
    hole[5:9, 4:12] = True
    gradient, t = guide.gradient(patch, hole, WINDOW, TimestepRange(0.3, 0.5, floored=False), generator())
    assert 0.3 <= t <= 0.5
    assert (gradient[~hole] == 0).all()
    assert (gradient[hole] != 0).all()


def test_gradient_is_that_of_a_mean_over_pixels_of_a_picture_in_signed_range(prior: InpaintingPrior) -> None:
    """L8: x = 2 rgb - 1, divided by the number of patch pixels."""
    patch, hole = torch.rand(16, 16, 3, generator=generator()), torch.zeros(16, 16, dtype=torch.bool)
    hole[5:9, 4:12] = True
    gradient, t = make_prior_guide("sds", prior, guidance=3.0).gradient(
        patch, hole, WINDOW, TimestepRange(0.4, 0.4, False), generator(5)
    )
    stream = generator(5)
    torch.rand((), generator=stream)
    x = (2 * patch - 1).permute(2, 0, 1)[None]
    eps = torch.randn(1, 3, 16, 16, generator=stream)
    fill = torch.randn(1, 3, 16, 16, generator=stream)
    level = torch.full((1,), t)
    query = PriorQuery(x, hole[None, None].float(), level, eps, fill)
    by_hand = sds_gradient(prior, query, guidance=3.0)
    torch.testing.assert_close(gradient, by_hand[0].permute(1, 2, 0) * 2 / 256)


def test_draws_are_fresh_at_every_call(guide: PriorGuide) -> None:
    """S3."""
    patch, hole = torch.rand(16, 16, 3, generator=generator()), torch.ones(16, 16, dtype=torch.bool)
    hole[0] = False
    stream = generator()
    (first, t1), (second, t2) = (
        guide.gradient(patch, hole, WINDOW, TimestepRange(0.2, 0.8, floored=False), stream) for _ in range(2)
    )
    assert t1 != t2
    assert not torch.equal(first, second)


def test_condition_is_the_rendered_patch_not_the_photo(
    field: RadianceField, guide: PriorGuide, view: MaskedView
) -> None:
    """S2: the photo's colours cannot matter, the field's known region does."""
    other = MaskedView(view.name, view.camera, 1 - view.image, view.hole, view.known)
    push = distilled(field, guide, view).push
    assert distilled(field, guide, other).push == push
    with torch.no_grad():
        field.base.table.add_(0.2)
    assert distilled(field, guide, view).push != push


def test_the_field_gets_the_prior_s_answer_and_the_prior_gets_nothing(
    field: RadianceField, prior: InpaintingPrior, view: MaskedView
) -> None:
    """S4: d(surrogate)/d(field) is the answer, a constant, times d(patch)/d(field); no gradient enters the prior."""
    assert all(p.requires_grad for p in prior.parameters())
    result = distilled(field, make_prior_guide("sds", prior, guidance=2.0), view)
    result.surrogate.backward()
    assert all(p.grad is None for p in prior.parameters())
    got = [torch.zeros(()) if p.grad is None else p.grad for p in field.parameters()]
    # By hand: the same rays with the same jitter, and the same draws for the prior after it.
    stream = generator()
    behind = torch.rand(3, generator=stream)
    jitter = generator(int(torch.randint(2**62, (1,), generator=stream)))
    hole = torch.from_numpy(WINDOW.sample(view.hole))
    rays = camera_rays(view.camera, WINDOW.pixels())
    inside, outside = (Rays(rays.origins[m], rays.directions[m]) for m in (hole, ~hole))
    patch = torch.empty(16, 16, 3)
    grounds = [behind.expand(len(part.origins), 3) for part in (inside, outside)]
    rgb = render(field, inside, generator=jitter, glo="mean", background=grounds[0], near_gradient=False).rgb
    patch[hole] = rgb.detach()
    patch[~hole] = render(field, outside, glo="mean", background=grounds[1]).rgb.detach()
    answer, _ = make_prior_guide("sds", prior, guidance=2.0).gradient(patch, hole, WINDOW, TIMES, stream)
    by_hand = torch.autograd.grad(rgb, list(field.parameters()), answer[hole], allow_unused=True)
    for a, b in zip(got, by_hand, strict=True):
        torch.testing.assert_close(a, torch.zeros_like(a) if b is None else b)
    assert max(float(g.abs().max()) for g in got) > 0


def test_blocks_rendered_again_give_the_gradient_of_blocks_kept_in_memory(
    field: RadianceField, guide: PriorGuide, view: MaskedView, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second rendering of a block draws the jitter of the first: else its gradient belongs to another picture."""
    again = distilled(field, guide, view, block=7)
    assert again.rays > 7
    total = again.surrogate + again.interlevel + again.distortion
    split = gradients(field, total)
    monkeypatch.setattr("inpaint3d.stages.joint_optimization.distil.checkpoint", lambda f, *a, **_: f(*a))
    kept = distilled(field, guide, view, block=7)
    for a, b in zip(split, gradients(field, kept.surrogate + kept.interlevel + kept.distortion), strict=True):
        torch.testing.assert_close(a, b)


def test_diffuse_only_start_leaves_the_specular_network_alone(
    field: RadianceField, guide: PriorGuide, view: MaskedView
) -> None:
    """S10."""
    specular = [n.startswith("specular") for n, _ in field.named_parameters()]
    for scale, moves in ((0.0, False), (1.0, True)):
        got = gradients(field, distilled(field, guide, view, specular_scale=scale).surrogate)
        largest = max(float(g.abs().max()) for g, s in zip(got, specular, strict=True) if s)
        assert (largest > 0) == moves


def test_renders_for_the_prior_take_the_mean_appearance(
    field: RadianceField, guide: PriorGuide, view: MaskedView
) -> None:
    """N6: every view's code gets the same share of the gradient."""
    names = [n for n, _ in field.named_parameters()]
    codes = gradients(field, distilled(field, guide, view).surrogate)[names.index("codes")]
    assert codes.abs().max() > 0
    torch.testing.assert_close(codes, codes[:1].expand_as(codes))


def test_what_a_guide_does_not_look_at_is_not_rendered(
    field: RadianceField, view: MaskedView, room: SyntheticScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Around the hole a completed picture is its own surround: the field's there costs rays and changes nothing."""
    guide, asked = PictureGuide([room.empty_images[0]], WINDOW.size), []
    query = field.query
    monkeypatch.setattr(field, "query", lambda points, *rest: asked.append(len(points)) or query(points, *rest))
    lean = distil_picture(field, guide, view)
    assert asked == [lean.rays * SPEC.samples]
    guide.needs_surround = True
    whole = distil_picture(field, guide, view)
    assert sum(asked[1:]) == WINDOW.size**2 * SPEC.samples
    assert lean.push == whole.push > 0
    for a, b in zip(gradients(field, lean.surrogate), gradients(field, whole.surrogate), strict=True):
        assert torch.equal(a, b)


def distil_picture(field: RadianceField, guide: PictureGuide, view: MaskedView) -> Distilled:
    return distil(field, guide, view, WINDOW, timesteps=TIMES, specular_scale=1.0, block=4096, generator=generator())
