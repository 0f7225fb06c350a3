"""Rows L1 to L3, L6 and L7: what the step's terms are taken over."""

import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.line_of_sight import line_of_sight_loss
from inpaint3d.radiance.losses import charbonnier, depth_smoothness_loss, distortion_loss, interlevel_loss
from inpaint3d.radiance.rays import Rays, camera_rays, join_rays
from inpaint3d.radiance.rendering import BACKGROUND, render
from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.stages.joint_optimization.batch import Batch
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.distil import Distilled
from inpaint3d.stages.joint_optimization.objective import Terms, gradient_norms, step_terms

SPEC = FieldSpec(
    grid=GridSpec(levels=3, coarsest=4, finest=32, log2_table=10, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=10, channels=1),
    proposal_samples=(8,), samples=8, density_width=8, bottleneck=0, view_layers=0,
    contraction=False, bound=2.0, far=5.0,
)  # fmt: skip
CONFIG = Config.model_validate({"optimizer": {"near_gradient": True}})
KNOWN, MASKED, PATCHES = 30, 10, (2, 4, 4)


@pytest.fixture
def field() -> RadianceField:
    field = RadianceField(SPEC, seed=0)
    with torch.no_grad():
        for parameter in field.parameters():
            parameter.add_(0.3 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(7)))
    return field


@pytest.fixture
def batch(room: SyntheticScene) -> Batch:
    rays = camera_rays(room.cameras[0]).flatten()
    first = rays[500 : 500 + KNOWN + MASKED]
    patch = camera_rays(room.cameras[1])
    squares = [Rays(patch.origins[a : a + 4, 8:12], patch.directions[a : a + 4, 8:12]).flatten() for a in (3, 20)]
    target = torch.rand(KNOWN, 3, generator=torch.Generator().manual_seed(1))
    return Batch(join_rays([first, *squares]), target, torch.empty(0), PATCHES)


def terms_of(field: RadianceField, batch: Batch, distilled: Distilled | None = None, weight: float = 0.0) -> Terms:
    stream = torch.Generator().manual_seed(0)
    return step_terms(field, batch, distilled, weight, CONFIG, anneal=1.0, generator=stream)


def test_each_term_is_the_paper_s_over_the_rays_that_it_is_meant_for(field: RadianceField, batch: Batch) -> None:
    """L2: reconstruction over the known rays and channels alone. L7: the rest over all. L3: the paper's weights."""
    stream, background = torch.Generator().manual_seed(0), torch.full((len(batch.rays.origins), 3), BACKGROUND)
    background[:KNOWN] = torch.rand(KNOWN, 3, generator=stream)
    seen = render(field, batch.rays, generator=stream, background=background)
    terms = terms_of(field, batch)
    torch.testing.assert_close(terms["reconstruction"], charbonnier(seen.rgb[:KNOWN] - batch.target).mean())
    torch.testing.assert_close(terms["interlevel"], interlevel_loss(seen))
    torch.testing.assert_close(terms["distortion"], 0.005 * distortion_loss(seen))
    depth = seen.depth[KNOWN + MASKED :].reshape(PATCHES)
    by_hand = 1e-4 * depth_smoothness_loss(depth, seen.rgb[KNOWN + MASKED :].reshape(*PATCHES, 3))
    torch.testing.assert_close(terms["depth"], by_hand)
    assert "distillation" not in terms


def test_masked_rays_pay_no_reconstruction_but_regularisers(field: RadianceField, batch: Batch) -> None:
    """L2 and L7: dropping the masked rays leaves the reconstruction as it is, and changes the distortion."""
    origins = batch.rays.origins
    keep = torch.ones(len(origins), dtype=torch.bool)
    keep[KNOWN : KNOWN + MASKED] = False
    without = Batch(Rays(origins[keep], batch.rays.directions[keep]), batch.target, torch.empty(0), PATCHES)
    # Without jitter, else the two draws differ in more than the rays.
    full, less = (step_terms(field, b, None, 0.0, CONFIG, anneal=1.0, generator=None) for b in (batch, without))
    torch.testing.assert_close(full["reconstruction"], less["reconstruction"])
    assert not torch.isclose(full["distortion"], less["distortion"], rtol=1e-4)


def test_rays_of_the_distilled_hole_count_among_the_regularised(field: RadianceField, batch: Batch) -> None:
    """L7: the mean is over all rays of the step: 72 in the batch, 24 in the hole."""
    hole = Distilled(torch.tensor(5.0), torch.tensor(2.0), torch.tensor(4.0), rays=24, t=0.5, push=1.0)
    alone, both = terms_of(field, batch), terms_of(field, batch, hole, weight=0.1)
    torch.testing.assert_close(both["interlevel"], 0.75 * alone["interlevel"] + 0.25 * 2.0)
    torch.testing.assert_close(both["distortion"], 0.75 * alone["distortion"] + 0.25 * 0.005 * 4.0)
    torch.testing.assert_close(both["distillation"], torch.tensor(0.5))


def test_the_papers_loss_weights_are_the_default() -> None:
    """L3."""
    config = Config()
    weights = config.loss_weights
    assert (weights.reconstruction, weights.interlevel) == (1.0, 1.0)
    assert (weights.distortion, weights.depth) == (0.005, 1e-4)
    assert config.depth_patches == 4


def test_gradient_norms_are_those_of_each_term_alone(field: RadianceField, batch: Batch) -> None:
    """L8."""
    terms = terms_of(field, batch)
    norms = gradient_norms(field, terms)
    assert set(norms) == set(terms)
    terms_of(field, batch)["reconstruction"].backward()
    squares = sum(float(p.grad.square().sum()) for p in field.parameters() if p.grad is not None)
    assert norms["reconstruction"] == pytest.approx(squares**0.5, rel=1e-5)
    # The graph is still there for the step itself.
    torch.stack(list(terms.values())).sum().backward()


def test_a_term_without_a_gradient_has_norm_0(field: RadianceField, batch: Batch) -> None:
    """A field whose sampler is a density grid has no proposals to teach."""
    terms = terms_of(field, batch) | {"interlevel": torch.tensor(0.0)}
    assert gradient_norms(field, terms)["interlevel"] == 0


def test_rays_to_sparse_points_are_those_before_the_patches(field: RadianceField, batch: Batch) -> None:
    """Their term alone is of them; reconstruction does not see them."""
    distance = torch.full((MASKED,), 0.8)
    sighted = Batch(batch.rays, batch.target, distance, PATCHES)
    assert sighted.sighted == slice(KNOWN, KNOWN + MASKED)
    plain, terms = terms_of(field, batch), terms_of(field, sighted)
    assert "line_of_sight" not in plain
    stream, background = torch.Generator().manual_seed(0), torch.full((len(batch.rays.origins), 3), BACKGROUND)
    background[:KNOWN] = torch.rand(KNOWN, 3, generator=stream)
    seen = render(field, batch.rays, generator=stream, background=background)
    by_hand = line_of_sight_loss(seen, slice(KNOWN, KNOWN + MASKED), distance)
    torch.testing.assert_close(terms["line_of_sight"], CONFIG.loss_weights.line_of_sight * by_hand)
    torch.testing.assert_close(terms["reconstruction"], plain["reconstruction"])
