import math
from pathlib import Path

import numpy as np
import pytest
import torch

from inpaint3d.contracts.errors import ArtifactError, Inpaint3dError
from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.checkpoints import load_checkpoint, save_checkpoint
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.fitting import LossWeights
from inpaint3d.radiance.io import load_field, save_field
from inpaint3d.radiance.optim import Adam, learning_rate
from inpaint3d.radiance.rendering import render
from inpaint3d.radiance.training import (
    Pixels,
    descend,
    proposal_anneal,
    rays_at,
    reconstruction,
    regularisers,
)
from inpaint3d.scene.cameras import Camera, look_at

SPEC = FieldSpec(
    grid=GridSpec(levels=3, coarsest=4, finest=32, log2_table=8, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(8,), samples=6, density_width=8, bottleneck=3, view_width=8, view_layers=1, glo=2, glo_views=2,
)  # fmt: skip
CAMERAS = [Camera(20, 20, 8, 6, 16, 12, look_at((0.8, y, 0.3), (0, 0, 0))) for y in (-0.2, 0.3)]


def pixels(known: list[np.ndarray | None] | None = None) -> Pixels:
    rng = np.random.default_rng(0)
    images = [rng.random((12, 16, 3), np.float32) for _ in CAMERAS]
    return Pixels.of(CAMERAS, images, known or [None, None])


def step(field: RadianceField, optimizer: Adam, source: Pixels, generator: torch.Generator) -> dict[str, float]:
    rays, target = source.draw(32, generator)
    seen = render(field, rays, generator=generator)
    terms = {"reconstruction": reconstruction(seen.rgb, target), **regularisers(seen, LossWeights())}
    return descend(field, optimizer, terms, learning_rate(optimizer.steps), {})


def test_the_papers_schedule() -> None:
    rates = [learning_rate(s) for s in range(3000)]
    assert rates[0] == pytest.approx(1e-4, rel=0.01)  # a hundredth, at the first of 100 warm-up steps
    assert rates[2200] == pytest.approx(1e-3)
    assert rates[2750] == pytest.approx(0.8e-3)  # beyond the paper's steps: as 1 / step
    assert rates[1100] == pytest.approx(math.sqrt(1e-2 * 1e-3))
    assert max(rates) < 1e-2


def test_rays_grow_geometrically() -> None:
    assert [rays_at(s, first=256, last=1024, ramp=100) for s in (0, 50, 100, 500)] == [256, 512, 1024, 1024]
    assert rays_at(0, first=256, last=1024, ramp=0) == 1024


def test_anneal_is_mip_nerf_360s() -> None:
    assert proposal_anneal(0, 100) == 0
    assert proposal_anneal(50, 100) == pytest.approx(5 / 5.5)
    assert proposal_anneal(100, 100) == proposal_anneal(1000, 100) == 1


def test_networks_learn_at_their_share_of_the_rate() -> None:
    """Adam's first step is the rate long, whatever the gradient."""
    field = RadianceField(SPEC, 0)
    before = {name: parameter.detach().clone() for name, parameter in field.named_parameters()}
    for parameter in field.parameters():
        parameter.grad = torch.full_like(parameter, 0.3)
    Adam(field, network_scale=0.2).step(0.5)
    for name, parameter in field.named_parameters():
        expected = 0.5 if name.endswith("table") else 0.1
        torch.testing.assert_close(before[name] - parameter, torch.full_like(parameter, expected), msg=name)


def test_drawn_colours_are_those_of_the_pixels_behind_the_rays() -> None:
    source = pixels()
    rays, rgb = source.draw(40, torch.Generator().manual_seed(0))
    assert rays.view is not None
    rng = np.random.default_rng(0)
    images = [rng.random((12, 16, 3), np.float32) for _ in CAMERAS]
    for origin, direction, view, colour in zip(rays.origins, rays.directions, rays.view.tolist(), rgb, strict=True):
        xy, z = CAMERAS[view].project((origin + direction).numpy())
        assert z > 0
        column, row = np.floor(xy).astype(int)
        np.testing.assert_array_equal(images[view][row, column], colour)


def test_pixels_that_are_not_known_are_never_drawn() -> None:
    known = np.zeros((12, 16), bool)
    known[2, 3] = True
    source = pixels([known, np.zeros_like(known)])
    assert len(source) == 1
    rays, _ = source.draw(50, torch.Generator().manual_seed(0))
    assert rays.view is not None
    assert (rays.view == 0).all()
    np.testing.assert_array_equal(source.column_row, [[3, 2]])


def test_steps_lower_the_loss_and_move_every_weight() -> None:
    field = RadianceField(SPEC, 0)
    optimizer, generator = Adam(field), torch.Generator().manual_seed(0)
    flat = Pixels.of(CAMERAS, [np.full((12, 16, 3), 0.8, np.float32)] * 2, [None, None])
    before = {name: p.detach().clone() for name, p in field.named_parameters()}
    losses = [step(field, optimizer, flat, generator)["reconstruction"] for _ in range(60)]
    assert np.mean(losses[-5:]) < 0.3 * np.mean(losses[:5])
    for name, parameter in field.named_parameters():
        assert not torch.equal(parameter, before[name]), name


def test_a_term_of_weight_zero_is_not_computed() -> None:
    field, source = RadianceField(SPEC, 0), pixels()
    seen = render(field, source.draw(8, torch.Generator().manual_seed(0))[0])
    assert regularisers(seen, LossWeights(interlevel=0.0, distortion=0.0)) == {}
    assert set(regularisers(seen, LossWeights())) == {"interlevel", "distortion"}


def test_non_finite_values_are_counted_located_and_stop_the_run() -> None:
    field = RadianceField(SPEC, 0)
    optimizer, generator, source = Adam(field), torch.Generator().manual_seed(0), pixels()
    step(field, optimizer, source, generator)
    before = {name: p.detach().clone() for name, p in field.named_parameters()}
    # sqrt has an infinite slope at 0, and 0 * inf is NaN
    poison = torch.sqrt(field.code_map[0] * 0).sum()
    counts: dict[str, int] = {}
    with pytest.raises(Inpaint3dError, match=r"step 1: gradient.code_map \(6\)"):
        descend(field, optimizer, {"poison": poison}, 1e-2, counts)
    assert counts == {"gradient.code_map": 6}
    with pytest.raises(Inpaint3dError, match=r"loss.total \(1\)"):
        descend(field, optimizer, {"total": field.base.table.sum() * math.inf}, 1e-2, {})
    for name, parameter in field.named_parameters():
        assert torch.equal(parameter, before[name]), name


def test_a_sparse_step_leaves_alone_what_no_ray_met() -> None:
    """Entries without a gradient keep their moments and do not decay; all others do as in a dense step."""
    fields = [RadianceField(SPEC, 0) for _ in range(2)]
    dense, sparse = Adam(fields[0], hash_decay=0.1), Adam(fields[1], hash_decay=0.1, sparse=True)
    before = fields[0].base.table.detach().clone()
    for field, optimizer in zip(fields, (dense, sparse), strict=True):
        step(field, optimizer, pixels(), torch.Generator().manual_seed(0))
    gradient = fields[0].base.table.grad
    assert gradient is not None
    met = gradient != 0
    assert 0.05 < met.float().mean() < 0.95
    assert torch.equal(fields[0].base.table[met], fields[1].base.table[met])
    assert torch.equal(fields[1].base.table[~met], before[~met])
    assert not torch.equal(fields[0].base.table[~met], before[~met])
    for name, parameter in fields[0].named_parameters():
        if not name.endswith("table"):
            assert torch.equal(parameter, dict(fields[1].named_parameters())[name]), name


@pytest.mark.parametrize("sampler", ["proposal", "density-grid"])
def test_a_restored_run_goes_on_exactly(tmp_path: Path, sampler: str) -> None:
    source = pixels()

    def start() -> tuple[RadianceField, Adam, torch.Generator]:
        field = RadianceField(SPEC.model_copy(update={"sampler": sampler, "density_cells": 8}), 0)
        return field, Adam(field), torch.Generator().manual_seed(0)

    field, optimizer, generator = start()
    for _ in range(3):
        step(field, optimizer, source, generator)
    save_checkpoint(tmp_path / "c.safetensors", field, optimizer, generator, {"curve": torch.tensor([1.5])})
    rest = [step(field, optimizer, source, generator) for _ in range(3)]

    field2, optimizer2, generator2 = start()
    step(field2, optimizer2, source, generator2)  # whatever was there is replaced
    extra = load_checkpoint(tmp_path / "c.safetensors", field2, optimizer2, generator2)
    assert extra is not None
    assert extra["curve"] == 1.5
    assert optimizer2.steps == 3
    assert [step(field2, optimizer2, source, generator2) for _ in range(3)] == rest
    for name, tensor in field.state_dict().items():
        assert torch.equal(tensor, field2.state_dict()[name]), name
    assert load_checkpoint(tmp_path / "none.safetensors", field2, optimizer2, generator2) is None


def test_weights_survive_the_disk_and_equal_weights_give_equal_bytes(tmp_path: Path) -> None:
    field = RadianceField(SPEC, 5)
    save_field(tmp_path / "a.safetensors", field)
    save_field(tmp_path / "b.safetensors", RadianceField(SPEC, 5))
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    again = load_field(tmp_path / "a.safetensors", SPEC)
    for name, tensor in field.state_dict().items():
        assert torch.equal(tensor, again.state_dict()[name])


def test_weights_of_another_spec_are_refused(tmp_path: Path) -> None:
    save_field(tmp_path / "a.safetensors", RadianceField(SPEC, 5))
    with pytest.raises(ArtifactError, match="code_map, codes differ"):
        load_field(tmp_path / "a.safetensors", SPEC.model_copy(update={"glo": 0}))
    (tmp_path / "b.safetensors").write_bytes(b"no weights")
    with pytest.raises(ArtifactError, match="cannot be read"):
        load_field(tmp_path / "b.safetensors", SPEC)
