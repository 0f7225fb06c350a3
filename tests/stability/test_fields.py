"""Activations, the optimiser and a fit's health: what a field computes and how it learns."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from inpaint3d.contracts.errors import ArtifactError, NonFiniteError
from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance import safe
from inpaint3d.radiance.artifact import write_view
from inpaint3d.radiance.backends import AdamStep, Name, select
from inpaint3d.radiance.checkpoints import go_back, load_checkpoint, save_checkpoint
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.health import Health, check_finite, find_non_finite
from inpaint3d.radiance.io import load_field, save_field
from inpaint3d.radiance.optim import Adam
from inpaint3d.radiance.rays import camera_rays
from inpaint3d.radiance.rendering import render
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.effects.contraction import cube_half_side
from tests.stability.catalogue import hard_case

ACTIVATIONS, ADAM, KEPT = "Activations", "Adam", "What is kept"
SPEC = FieldSpec(
    grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(4,), samples=4, density_width=8, bottleneck=4, view_width=8, view_layers=1,
)  # fmt: skip
BACKENDS: list[Name] = ["reference", "native"]


@hard_case(
    ACTIVATIONS,
    plain="exp overflows above 88; clamped, it has no gradient there and could never come down",
    ours="e^min(x, 15), whose gradient is its value",
    swept="x of -3e38 to 3e38, gradients 1e-30 to 1e30; relative 1e-6",
)
@pytest.mark.parametrize("x", [-3e38, -1e4, -100.0, -88.0, -1e-30, 0.0, 1e-8, 1.0, 14.99, 15.01, 89.0, 1e4, 3e38])
@pytest.mark.parametrize("slope", [1e-30, 1.0, 1e30])
def test_density(x: float, slope: float) -> None:
    given = torch.tensor([x], requires_grad=True)
    made = safe.exp(given)
    made.backward(torch.tensor([slope]))
    exact = math.exp(min(x, 15.0)) if x > -200 else 0.0
    assert float(made.detach()) == pytest.approx(exact, rel=2e-6, abs=1e-44)
    assert given.grad is not None
    assert float(given.grad) == pytest.approx(float(made.detach()) * slope, rel=1e-6, abs=1e-44)


@hard_case(
    ACTIVATIONS,
    plain="s (1 - s) is 0 in float32 from x = 17 on: what is white once stays so for good",
    ours="a slope of at least 1e-4, so that Adam finds a way back; nothing else changes",
    swept="x of -1e30 to 1e30, both backends; below 9 the plain slope, bit for bit",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("x", [-1e30, -100.0, -20.0, -5.0, 0.0, 6.9, 9.0, 17.0, 20.0, 88.0, 100.0, 1e30])
def test_colour(backend: Name, x: float) -> None:
    logits = torch.full((1, 3), x, requires_grad=True)
    shown, _ = select("cpu", backend).colours(logits, None, None)
    shown.sum().backward()
    assert logits.grad is not None
    share = torch.sigmoid(torch.tensor(x))
    plain = float(share * (1 - share))
    assert float(logits.grad[0, 0]) == pytest.approx(1.002 * max(plain, 1e-4), rel=2e-6, abs=0)


@hard_case(
    ACTIVATIONS,
    plain="3,000 steps from a logit of +20 towards grey move nothing",
    ours="the slope that is left leads back",
    swept="logits of -60 to 60, Adam, 0.05 a step: within 0.01 of grey after 3,000 steps",
)
@pytest.mark.parametrize("start", [-60.0, -20.0, 20.0, 60.0])
def test_white_and_black_can_become_grey(start: float) -> None:
    logit, m, v = torch.full((1, 3), start), torch.zeros(1, 3), torch.zeros(1, 3)
    backend = select("cpu")
    for step in range(1, 3001):
        given = logit.clone().requires_grad_()
        ((backend.colours(given, None, None)[0] - 0.5) ** 2).sum().backward()
        assert given.grad is not None
        backend.adam_step(logit, given.grad, m, v, AdamStep(step, 0.05, 0.9, 0.99, 1e-15))
    assert float(torch.sigmoid(logit).sub(0.5).abs().max()) < 0.01


def one_adam_step(backend: Name, grad: float, *, param: float = 1.0, m: float = 0.0, v: float = 0.0):
    state = [torch.full((3,), number) for number in (param, m, v)]
    how = AdamStep(1, 1e-2, 0.9, 0.99, 1e-15)
    lost = select("cpu", backend).adam_step(state[0], torch.full((3,), grad), state[1], state[2], how)
    return lost, state


@hard_case(
    ADAM,
    plain="g^2 overflows above 1.8e19, the second moment is inf for ever, the number never moves again",
    ours="a number whose gradient's square is not finite is left alone, moments too, and counted",
    swept="gradients 1e-38 to 3e38, both signs, both backends",
    told="the step is traced, the fit goes back once; then `non-finite values at step N: gradient.TENSOR (COUNT)` "
    "(exit code 1)",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("size", [1e-38, 1e-20, 1e-10, 1.0, 1e10, 1.8e19, 1.9e19, 1e25, 3.4e38])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_adam_of_any_finite_gradient(backend: Name, size: float, sign: float) -> None:
    lost, (param, m, v) = one_adam_step(backend, sign * size)
    assert all(part.isfinite().all() for part in (param, m, v))
    if size > 1.85e19:
        assert lost == 3
        assert (param == 1).all()
    else:
        assert lost == 0
        # The first step is as long as the rate, unless eps or denormal moments are larger than the gradient.
        if size >= 1e-10:
            torch.testing.assert_close(param, torch.full((3,), 1 - sign * 1e-2), rtol=1e-5, atol=0)
    # Whatever came, the next gradient moves it.
    before = param.clone()
    how = AdamStep(2, 1e-2, 0.9, 0.99, 1e-15)
    select("cpu", backend).adam_step(param, torch.ones(3), m, v, how)
    if size <= 1e3 or size > 1.85e19:
        assert (param < before).all()


@hard_case(
    ADAM,
    plain="a NaN in a number or a moment makes every later step NaN, and is counted as nothing",
    ours="a step whose result is not finite is not taken, and counted",
    swept="NaN and inf in the gradient, the number, the first and the second moment; both backends",
    told="`non-finite values at step N: gradient.TENSOR (COUNT)`, with where it began (exit code 1)",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("where", ["grad", "param", "m", "v"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_adam_of_broken_state(backend: Name, where: str, value: float) -> None:
    given = {"grad": 1.0, "v": 1.0} | {where: value}
    lost, state = one_adam_step(backend, given.pop("grad"), **given)
    assert lost == 3
    expected = [given.get("param", 1.0), given.get("m", 0.0), given.get("v", 0.0)]
    for part, before in zip(state, expected, strict=True):
        np.testing.assert_array_equal(part.numpy(), np.full(3, before, np.float32))


@hard_case(
    ADAM,
    plain="moments decay into denormal numbers; v = 0 divides by nothing",
    ours="eps = 1e-15 beside the root; the kernel flushes denormal moments",
    swept="v of 0, 1e-45 to 3e38 under a gradient of 0, 5 million steps",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("v", [0.0, 1e-45, 1e-38, 1.0, 3e38])
@pytest.mark.parametrize("step", [1, 5_000_000])
def test_adam_without_gradient(backend: Name, v: float, step: int) -> None:
    param, m, second = torch.ones(3), torch.zeros(3), torch.full((3,), v)
    how = AdamStep(step, 1e-2, 0.9, 0.99, 1e-15)
    assert select("cpu", backend).adam_step(param, torch.zeros(3), m, second, how) == 0
    assert (param == 1).all()
    assert second.isfinite().all()


@hard_case(
    ADAM,
    plain="a rare entry of a table rests for long: its bias correction is that of the step, not of its own count",
    ours="sparse steps leave it alone, moments and decay too",
    swept="gradients of exactly 0 among others, NaN among zeros; both backends",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("value", [0.0, math.nan])
def test_sparse_adam(backend: Name, value: float) -> None:
    param, m, v, grad = torch.ones(40), torch.full((40,), 0.1), torch.ones(40), torch.zeros(40)
    grad[7], grad[33] = 1.0, value
    how = AdamStep(5, 1e-2, 0.9, 0.99, 1e-15, 1e-3, sparse=True)
    lost = select("cpu", backend).adam_step(param, grad, m, v, how)
    assert lost == (0 if value == 0 else 1)
    assert (param != 1).nonzero().flatten().tolist() == [7]


@hard_case(
    KEPT,
    plain="a NaN in one table entry ends as `done`",
    ours="weights are summed before every commit: a sum that is not finite is looked at number by number",
    swept="NaN, inf, -inf in the first, a rare and the last entry of a table, of a network, of a moment",
    told="`weights that are not finite after step N: TENSOR (COUNT, the first at [ENTRY, CHANNEL])` (exit code 1)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["base.table", "base.weights.0", "proposal.table", "specular.1", "moment"])
def test_broken_weights_are_never_kept(tmp_path: Path, value: float, name: str) -> None:
    field = RadianceField(SPEC, 0)
    optimizer, stream = Adam(field), torch.Generator()
    save_checkpoint(tmp_path / "c.safetensors", field, optimizer, stream)
    before = (tmp_path / "c.safetensors").read_bytes()
    with torch.no_grad():
        part = optimizer.moments(field.base.table)[1] if name == "moment" else dict(field.named_parameters())[name]
        part[-1, -1] = value
    place = "second moment of base.table" if name == "moment" else name
    with pytest.raises(NonFiniteError, match=rf"{place} \(1, the first at"):
        save_checkpoint(tmp_path / "c.safetensors", field, optimizer, stream)
    assert (tmp_path / "c.safetensors").read_bytes() == before
    if name != "moment":
        with pytest.raises(NonFiniteError, match=place):
            save_field(tmp_path / "w.safetensors", field)
        assert not (tmp_path / "w.safetensors").exists()


@hard_case(
    KEPT,
    plain="finite numbers whose sum overflows look like NaN to a cheap test",
    ours="only a look at each number decides",
    swept="weights of 3e38 in every entry",
)
def test_huge_weights_are_finite() -> None:
    field = RadianceField(SPEC, 0)
    with torch.no_grad():
        field.base.table.fill_(3e38)
    check_finite(field)
    assert find_non_finite({"x": field.base.table}) == []


@hard_case(
    KEPT,
    plain="a field of NaN, read by a later stage, is a far surface",
    ours="an artifact's weights are looked at when they are read",
    swept="NaN in one entry",
    told="`weights PATH are not finite: TENSOR (1, the first at [...])` (exit code 3)",
)
def test_broken_weights_are_never_read(tmp_path: Path) -> None:
    from safetensors.torch import load_file, save_file

    save_field(tmp_path / "w.safetensors", RadianceField(SPEC, 0))
    weights = load_file(tmp_path / "w.safetensors")
    weights["base.table"][5, 1] = math.nan
    save_file(weights, tmp_path / "w.safetensors")
    with pytest.raises(ArtifactError, match=r"not finite: base.table \(1, the first at \[5, 1\]\)"):
        load_field(tmp_path / "w.safetensors", SPEC)


@hard_case(
    KEPT,
    plain="a NaN in a map is written as some colour, or as no depth",
    ours="maps are looked at before they are written",
    swept="NaN and inf in colour, depth and opacity",
    told="`the render of view NAME is not finite: MAP in COUNT numbers, the first at row R, column C` (exit code 1)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["rgb", "depth", "median_depth", "opacity"])
def test_broken_pictures_are_never_kept(tmp_path: Path, value: float, name: str) -> None:
    camera = Camera(4, 4, 2, 2, 4, 4, look_at((0, -1, 0), (0, 0, 0)))
    maps = {n: np.ones((4, 4)) for n in ("depth", "median_depth", "opacity")} | {"rgb": np.ones((4, 4, 3))}
    maps[name][2, 1] = value
    with pytest.raises(NonFiniteError, match=rf"view a is not finite: {name} in \d numbers, the first at row 2, col"):
        write_view(tmp_path, "a", camera, maps)
    assert not list(tmp_path.rglob("*.png"))


@hard_case(
    KEPT,
    plain="a fit that fails for good, or goes on for ever, at a step that is not finite",
    ours="back to the last checkpoint once, with half the steps; the count lies in the checkpoint",
    swept="0, 1 and 2 rollbacks allowed; with and without a checkpoint",
    told="`...; went back N times before; the last good checkpoint is kept in FOLDER` (exit code 1)",
)
@pytest.mark.parametrize("allowed", [0, 1, 2])
def test_a_fit_goes_back_as_often_as_it_may(tmp_path: Path, allowed: int) -> None:
    field = RadianceField(SPEC, 0)
    optimizer, stream, path = Adam(field), torch.Generator().manual_seed(3), tmp_path / "c.safetensors"
    error = NonFiniteError("loss.reconstruction (1)")
    with pytest.raises(NonFiniteError, match="there is no checkpoint yet"):
        go_back(path, field, optimizer, stream, error, allowed)
    save_checkpoint(path, field, optimizer, stream, {"row": torch.ones(1)})
    for time in range(allowed):
        optimizer.steps = 7
        assert go_back(path, field, optimizer, stream, error, allowed)["row"] == 1
        assert (optimizer.steps, optimizer.halvings) == (0, time + 1)
        save_checkpoint(path, field, optimizer, stream, {"row": torch.ones(1)})
    with pytest.raises(NonFiniteError, match=r"loss.reconstruction \(1\).*checkpoint is kept in"):
        go_back(path, field, optimizer, stream, error, allowed)
    other = Adam(field)
    load_checkpoint(path, field, other, stream)
    assert other.halvings == allowed


def test_a_halved_fit_takes_steps_half_as_long() -> None:
    moved = []
    for halvings in (0, 1):
        field = RadianceField(SPEC, 0)
        optimizer, before = Adam(field), field.code_map.detach().clone() if SPEC.glo else None
        optimizer.halvings = halvings
        start = field.base.weights[0].detach().clone()
        field.base.weights[0].sum().backward()
        optimizer.step(1e-2)
        moved.append((field.base.weights[0].detach() - start).abs().mean())
        assert before is None or torch.equal(field.code_map, before)
    assert float(moved[1]) == pytest.approx(float(moved[0]) / 2, rel=1e-4)


@hard_case(
    KEPT,
    plain="a fit that creeps towards its limits shows nothing of it",
    ours="gradient norms, densities at the ceiling and saturated colours are counted by stage",
    swept="fields pushed to white, to solid, and as they start",
    told="in the artifact's `health`, and in the report",
)
@pytest.mark.parametrize(
    ("heads", "counter"), [([0], "density_at_ceiling"), ([1, 2, 3], "colour_saturated"), ([], None)]
)
def test_health_counts_what_saturates(heads: list[int], counter: str | None) -> None:
    field = RadianceField(SPEC, 0)
    with torch.no_grad():
        field.base.table.fill_(1.0)
        field.base.weights[0].fill_(1.0)
        field.base.weights[1].fill_(0.0)
        field.base.weights[1][heads] = 1e3
    health = Health()
    field.base.table.sum().backward()
    health.look(field, camera_rays(Camera(4, 4, 2, 2, 4, 4, look_at((0, -1, 0), (0, 0, 0)))).flatten())
    found = health.counters(Adam(field))
    assert found["gradient_norm_largest"] == pytest.approx(math.sqrt(field.base.table.numel()), rel=1e-5)
    assert found["density_at_ceiling"] == (1.0 if counter == "density_at_ceiling" else 0.0)
    assert (found["colour_saturated"] > 0.9) == (counter == "colour_saturated")
    again = Health()
    again.restore(health.tensors())
    assert again.counters(Adam(field)) == found


def test_gradient_norms_do_not_overflow() -> None:
    field = RadianceField(SPEC, 0)
    (1e19 * field.base.table.sum()).backward()
    health = Health()
    health.look(field, camera_rays(Camera(2, 2, 1, 1, 2, 2, look_at((0, -1, 0), (0, 0, 0)))).flatten())
    found = health.counters(Adam(field))["gradient_norm_largest"]
    assert found == pytest.approx(1e19 * math.sqrt(field.base.table.numel()), rel=1e-5)


@hard_case(
    KEPT,
    plain="a NaN weight renders as an empty, far view",
    ours="what is not finite in the field is not finite in its pictures",
    swept="NaN in the table's every entry, in one network weight",
)
@pytest.mark.parametrize("name", ["base.table", "base.weights.1"])
def test_a_broken_field_renders_no_far_surface(name: str) -> None:
    field = RadianceField(SPEC, 0)
    with torch.no_grad():
        dict(field.named_parameters())[name].fill_(math.nan)
        seen = render(field, camera_rays(Camera(4, 4, 2, 2, 4, 4, look_at((0, -1, 0), (0, 0, 0)))))
    assert seen.depth.isnan().all()
    assert seen.median_depth.isnan().all()


@hard_case(
    "Size of the scene",
    plain="a percentile of 99 lets 1.5 % of points at 50 units make the cube 35 times as wide",
    ours="points that reach twice as far as all but 3 % do not count",
    swept="0 to 1.9 % of the points at 5, 50 and 1e6 units; no points; all at one place",
)
@pytest.mark.parametrize("share", [0.0, 0.005, 0.015, 0.019])
@pytest.mark.parametrize("away", [5.0, 50.0, 1e6])
def test_far_points_do_not_widen_the_cube(share: float, away: float) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.4, 1.4, (2000, 3)).astype(np.float32)
    clean = cube_half_side(points)
    points[: int(share * len(points))] *= away
    assert cube_half_side(points) == pytest.approx(clean, rel=0.02)
    # The cameras, which reach to 1, lie in it too.
    assert cube_half_side(points[:0]) == cube_half_side(points[-50:] / 10) == pytest.approx(1.1)
