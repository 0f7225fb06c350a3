import numpy as np
import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.fields import RadianceField, Samples
from inpaint3d.radiance.rays import camera_rays
from inpaint3d.radiance.rendering import damp_near_camera, render, render_view
from inpaint3d.radiance.volume import alpha_weights
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.geometry import ray_sphere

SPEC = FieldSpec(
    grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(64, 64), samples=32, density_width=8, bottleneck=3, view_width=8, view_layers=1, glo=2,
    glo_views=3, near=0.05, far=100.0,
)  # fmt: skip
CAMERA = Camera(60, 60, 24, 18, 48, 36, look_at((0.9, 0.0, 0.3), (0, 0, 0)))
RADIUS = 0.3


class Ball(RadianceField):
    """A field whose weights are not asked: an opaque red ball at the origin in empty space."""

    def density(self, points: torch.Tensor) -> torch.Tensor:
        return torch.where(torch.linalg.vector_norm(points, dim=-1) < RADIUS, 1e6, 0.0)

    def proposal_density(self, points: torch.Tensor) -> torch.Tensor:
        return self.density(points)

    def query(
        self,
        points: torch.Tensor,
        towards: torch.Tensor,
        appearance: torch.Tensor | None = None,
        specular_scale: float = 1.0,
    ) -> Samples:
        red = torch.tensor([0.9, 0.2, 0.1]).expand(len(points), 3)
        return Samples(self.density(points), red, red)


@pytest.fixture(scope="module")
def noise() -> RadianceField:
    made = RadianceField(SPEC, 0)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=generator))
    return made


def test_a_ball_is_seen_where_it_is() -> None:
    seen = render_view(Ball(SPEC, 0), CAMERA)
    origins, directions = CAMERA.rays()
    near, _, _ = ray_sphere(origins, directions, np.zeros(3), RADIUS)
    hit = np.isfinite(near) & (near > 0)
    z = np.where(hit, near, 0) * (directions @ CAMERA.forward)
    # within the ball's limb, where a ray's two crossings are not a sample apart
    inner, _, _ = ray_sphere(origins, directions, np.zeros(3), 0.9 * RADIUS)
    core = np.isfinite(inner) & (inner > 0)
    assert core.sum() > 200
    assert (seen["opacity"][core] > 0.99).all()
    np.testing.assert_allclose(seen["rgb"][core], np.tile([0.9, 0.2, 0.1], (core.sum(), 1)), atol=5e-3)
    # half of the first proposals' spacing there: an interval counts as in the ball if its middle is
    np.testing.assert_allclose(seen["depth"][core], z[core], atol=0.023)
    np.testing.assert_allclose(seen["median_depth"][core], z[core], atol=0.023)
    # empty rays end at the far plane, over the background
    assert (seen["opacity"][~hit] == 0).all()
    np.testing.assert_allclose(seen["depth"][~hit], SPEC.far * (directions @ CAMERA.forward)[~hit], rtol=1e-5)
    np.testing.assert_allclose(seen["rgb"][~hit], 0.5)


def test_proposal_rounds_ask_one_network_and_the_last_round_another(noise: RadianceField) -> None:
    """N2: both rounds' weights are one network's at their own intervals; the field's own come from another."""
    rays = camera_rays(CAMERA).flatten()[:50]
    seen = render(noise, rays, generator=torch.Generator().manual_seed(0))
    assert [weights.shape[1] for _, weights in seen.proposals] == [64, 64]
    asked = [*seen.proposals, (seen.sdist, seen.weights)]
    densities = (noise.proposal_density, noise.proposal_density, noise.density)
    for (sdist, weights), density in zip(asked, densities, strict=True):
        tdist = noise.spacing.metric_from_normalised(sdist)
        middle = (tdist[:, 1:] + tdist[:, :-1]) / 2
        points = rays.origins[:, None] + rays.directions[:, None] * middle[..., None]
        by_hand = alpha_weights(density(points.reshape(-1, 3)).reshape(middle.shape), tdist)
        # random weights make densities of e^10: a rounding of the point shows
        torch.testing.assert_close(weights, by_hand, rtol=1e-3, atol=1e-4)


def test_a_ray_has_no_width(noise: RadianceField) -> None:
    """N1, no cone tracing: with three times the pixels, every third ray and its colour are the same."""
    fine = render(noise, camera_rays(CAMERA.resize_to(3 * CAMERA.width, 3 * CAMERA.height)))
    torch.testing.assert_close(fine.rgb[1::3, 1::3], render(noise, camera_rays(CAMERA)).rgb, rtol=1e-3, atol=1e-3)


def test_weights_sum_to_at_most_one_and_make_the_opacity(noise: RadianceField) -> None:
    seen = render(noise, camera_rays(CAMERA, view=1), generator=torch.Generator().manual_seed(0))
    assert seen.rgb.shape == (36, 48, 3)
    assert seen.weights.shape == (36, 48, 32)
    assert seen.tdist.shape == (36, 48, 33)
    assert (seen.weights >= 0).all()
    assert seen.weights.sum(-1).max() <= 1 + 1e-5  # 32 float32 additions
    torch.testing.assert_close(seen.weights.sum(-1), seen.opacity)
    assert [w.shape[-1] for _, w in seen.proposals] == [64, 64]
    for depth in (seen.depth, seen.median_depth):
        assert (depth >= SPEC.near * 0.99).all()
        assert (depth <= SPEC.far * 1.01).all()


def test_without_a_generator_it_repeats_and_with_one_the_seed_decides(noise: RadianceField) -> None:
    rays = camera_rays(CAMERA)
    assert torch.equal(render(noise, rays).rgb, render(noise, rays).rgb)
    one, same, other = (render(noise, rays, generator=torch.Generator().manual_seed(s)).rgb for s in (0, 0, 1))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_blocks_do_not_show(noise: RadianceField) -> None:
    whole, blocks = render_view(noise, CAMERA), render_view(noise, CAMERA, block=100)
    for name, picture in whole.items():
        # matrix products of other shapes round differently
        np.testing.assert_allclose(blocks[name], picture, rtol=1e-3, atol=1e-4, err_msg=name)


def test_the_mean_code_is_taken_unless_a_view_is_named(noise: RadianceField) -> None:
    mean, own = render_view(noise, CAMERA), render_view(noise, CAMERA, view=2)
    assert not np.allclose(mean["rgb"], own["rgb"], atol=1e-3)
    np.testing.assert_array_equal(mean["depth"], own["depth"])
    rays = camera_rays(CAMERA, view=2)
    torch.testing.assert_close(render(noise, rays, glo="mean").rgb, render(noise, camera_rays(CAMERA)).rgb)


def test_the_background_is_seen_through_what_is_not_opaque(noise: RadianceField) -> None:
    rays = camera_rays(CAMERA)
    black, white = render(noise, rays, background=0.0), render(noise, rays, background=1.0)
    torch.testing.assert_close(white.rgb - black.rgb, (1 - black.opacity)[..., None].expand(36, 48, 3))
    each = torch.rand(36, 48, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(
        render(noise, rays, background=each).rgb, black.rgb + (1 - black.opacity)[..., None] * each
    )


def test_all_weights_get_finite_gradients(noise: RadianceField) -> None:
    rays = camera_rays(CAMERA, view=0)
    seen = render(noise, rays, generator=torch.Generator().manual_seed(0), near_gradient=False)
    loss = seen.rgb.mean() + seen.depth.mean() + sum(w.square().mean() for _, w in seen.proposals)
    noise.zero_grad()
    loss.backward()  # pyright: ignore[reportAttributeAccessIssue]
    for name, parameter in noise.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() > 0, name


def test_damping_changes_gradients_near_the_camera_and_no_value() -> None:
    density = torch.tensor([[0.3, 0.7]], requires_grad=True)
    rgb = torch.rand(1, 2, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    same_density, same_rgb = damp_near_camera(density, rgb, torch.tensor([[0.1, 0.3, 5.0]]))
    assert torch.equal(same_density, density)
    assert torch.equal(same_rgb, rgb)
    (same_density.sum() + same_rgb.sum()).backward()
    torch.testing.assert_close(density.grad, torch.tensor([[0.04, 1.0]]))
    torch.testing.assert_close(rgb.grad, torch.tensor([0.04, 1.0])[None, :, None].expand(1, 2, 3))
