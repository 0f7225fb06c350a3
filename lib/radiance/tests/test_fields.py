import pytest
import torch

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.backends import reference
from inpaint3d.radiance.fields import RadianceField

SPEC = FieldSpec(
    grid=GridSpec(levels=3, coarsest=4, finest=32, log2_table=8, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(8,), samples=6, density_width=8, bottleneck=3, view_width=8, view_layers=2, glo=2, glo_views=3,
)  # fmt: skip


def field(seed: int = 0, **update: object) -> RadianceField:
    made = RadianceField(SPEC.model_copy(update=update), seed, backend="reference")
    generator = torch.Generator().manual_seed(seed + 1)
    with torch.no_grad():
        for parameter in made.parameters():  # far from the start, where everything is alike
            parameter.copy_(torch.randn(parameter.shape, generator=generator))
    return made


def points(count: int, scale: float, seed: int = 0) -> torch.Tensor:
    return scale * torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))


def towards(count: int, seed: int = 1) -> torch.Tensor:
    return torch.nn.functional.normalize(points(count, 1.0, seed), dim=-1)


@pytest.mark.parametrize("contraction", [True, False])
@pytest.mark.parametrize("exponent", [-30, -3, 0, 3, 10, 30])
def test_values_and_gradients_are_finite_anywhere_in_space(exponent: int, contraction: bool) -> None:
    made = field(contraction=contraction)
    where = points(64, 10.0**exponent)
    seen = made.query(where, towards(64), made.appearance(torch.arange(64) % 3, "view"))
    (seen.density.sum() + seen.rgb.sum() + seen.diffuse.sum() + made.proposal_density(where).sum()).backward()
    assert (seen.density > 0).all()
    assert seen.rgb.min() >= -0.0011
    assert seen.rgb.max() <= 1.0011
    for name, parameter in made.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name


def test_black_and_white_can_be_reached() -> None:
    logits = torch.tensor([[-8.0, 0.0, 8.0]])
    shown = reference.colours(logits, None, None)[0][0]
    assert shown[0] < 0
    assert shown[1] == 0.5
    assert shown[2] > 1


def test_diffuse_colour_and_density_do_not_depend_on_the_direction() -> None:
    made, where = field(), points(32, 0.5)
    one, other = made.query(where, towards(32, 1)), made.query(where, towards(32, 2))
    assert torch.equal(one.diffuse, other.diffuse)
    assert torch.equal(one.density, other.density)
    assert not torch.allclose(one.rgb, other.rgb)


def test_specular_scale_leads_from_diffuse_to_full_colour() -> None:
    made, where = field(), points(32, 0.5)
    with torch.no_grad():
        made.base.weights[1].mul_(0.1)  # logits of saturated colours could not be told
    none, half, full = (made.query(where, towards(32), specular_scale=s) for s in (0.0, 0.5, 1.0))
    torch.testing.assert_close(none.rgb, none.diffuse)
    zero, one, two = (torch.logit((seen.rgb + 0.001) / 1.002) for seen in (none, half, full))
    torch.testing.assert_close(one - zero, (two - zero) / 2, rtol=1e-3, atol=1e-4)


def test_appearance_is_the_views_own_or_the_mean() -> None:
    made = field()
    own = made.appearance(torch.tensor([0, 1, 2]), "view")
    assert own is not None
    mean = made.appearance(torch.tensor([0, 1, 2]), "mean")
    assert mean is not None
    torch.testing.assert_close(own.mean(0, keepdim=True), mean)
    assert torch.equal(made.appearance(None, "view"), mean)
    assert field(glo=0).appearance(torch.tensor([0]), "view") is None


def test_a_new_field_shows_every_view_alike() -> None:
    made = RadianceField(SPEC, 0)
    own = made.appearance(torch.tensor([0, 1, 2]), "view")
    assert own is not None
    assert (own == 0).all()


def test_beyond_the_cube_space_continues_its_border() -> None:
    made = field(contraction=False, bound=2.0)
    inside = torch.tensor([[2.0, 0.3, -2.0]])
    outside = torch.tensor([[50.0, 0.3, -7.0]])
    torch.testing.assert_close(made.density(outside), made.density(inside))


def test_the_seed_decides_the_weights() -> None:
    def table(seed: int) -> torch.Tensor:
        return RadianceField(SPEC, seed).base.table

    assert torch.equal(table(3), table(3))
    assert not torch.equal(table(3), table(4))


@pytest.mark.parametrize(
    ("update", "message"),
    [
        ({"samples": 1}, "at least 2"),
        ({"proposal_samples": (8, 1)}, "at least 2"),
        ({"near": 5.0, "far": 2.0}, "near 5.0 is not below far 2.0"),
        ({"bottleneck": 0}, "bottleneck"),
    ],
)
def test_an_architecture_that_cannot_be_built_is_refused(update: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        RadianceField(SPEC.model_copy(update=update), 0)
