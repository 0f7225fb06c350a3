"""Rows S6 to S10 in the loop itself: which count from the start of distillation, and which on the global step."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from inpaint3d.contracts.errors import BadInputError, NonFiniteError
from inpaint3d.contracts.kit.context import Context, Inputs
from inpaint3d.contracts.models.pipeline import merge_parameters
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import Store
from inpaint3d.radiance.health import check_finite
from inpaint3d.scene.masked_views import MaskedScene, MaskedView, find_fillable
from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.scene.windows import Window
from inpaint3d.stages.joint_optimization.centre_views import choose_centre_views
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.curves import Curves
from inpaint3d.stages.joint_optimization.guidance import PriorGuide, Timesteps
from inpaint3d.stages.joint_optimization.loop import optimise
from inpaint3d.stages.joint_optimization.parallel import Ranks
from inpaint3d.stages.joint_optimization.problem import Problem, trace_sparse_points
from inpaint3d.stages.joint_optimization.run import pose

TINY = yaml.safe_load((Path(__file__).parent / "tiny.yaml").read_text())
# Four steps of reconstruction first; everything that anneals has its own length.
PARAMETERS = merge_parameters(
    TINY,
    {
        "steps": 40,
        "estimator": {
            "schedule_steps": 80, "warmup_steps": 4, "weight_warmup": 10, "centre_steps": 6, "centre_views": 1,
            "t_min": 0.2, "t_width": 0.2, "diffuse_start": True,
        },
    },
)  # fmt: skip
Make = Callable[..., Problem]


class Noting(PriorGuide):
    """Notes which window it is asked about."""

    def gradient(
        self,
        patch: torch.Tensor,
        hole: torch.Tensor,
        window: Window,
        timesteps: Timesteps,
        generator: torch.Generator,
    ) -> tuple[torch.Tensor, float]:
        self.asked = window
        return super().gradient(patch, hole, window, timesteps, generator)


@pytest.fixture
def posed(store: Store, inputs: Callable[..., dict[str, Any]]) -> Make:
    def make(**parameters: Any) -> Problem:
        config = Config.model_validate(merge_parameters(PARAMETERS, parameters))
        spec = load_stage(Path(__file__).parents[1] / "stage.yaml")
        problem, _ = pose(config, Inputs(store, spec, inputs()), 0, "cpu")
        assert isinstance(problem.guide, PriorGuide)
        return replace(problem, guide=Noting(problem.guide.prior, problem.guide.estimate))

    return make


def figures(problem: Problem, step: int) -> dict[str, float]:
    return problem.terms(step, Ranks())[1]


def test_the_first_steps_only_reconstruct(posed: Make) -> None:
    """S7; a field that is not fresh is distilled at once."""
    problem = posed()
    assert [figures(problem, step) == {} for step in (0, 3, 4)] == [True, True, False]
    assert "distillation" not in problem.terms(3, Ranks())[0]
    assert figures(replace(problem, fresh=False), 0) != {}


def test_rays_are_counted_as_they_are_drawn(posed: Make) -> None:
    """Of the patches for depth smoothness too, which a weight of 0 leaves out (L6)."""
    for weight in (1e-4, 0.0):
        problem = posed(loss_weights={"depth": weight, "line_of_sight": 0.0})
        batch = problem.bank.draw(
            problem.config.rays,
            patches=problem.patches,
            patch_size=problem.config.depth_patch_size,
            generator=torch.Generator().manual_seed(0),
            sighted=0,
        )
        assert problem.count_rays(Ranks()) == len(batch.rays.origins)


def test_the_weight_rises_from_the_start_of_distillation(posed: Make) -> None:
    """S6: nothing at step 4, half at step 9, all from step 14 on."""
    problem = posed()
    assert [figures(problem, step)["weight"] for step in (4, 9, 14, 30)] == pytest.approx([0.0, 0.05, 0.1, 0.1])
    assert figures(replace(problem, fresh=False), 5)["weight"] == pytest.approx(0.05)


def test_centre_views_come_first_from_the_start_of_distillation(posed: Make) -> None:
    """S8: steps 4 to 9 look at the one centre view; on the global step only 4 and 5 would."""
    problem = posed()
    shown = problem.to_fill
    seen = find_fillable(shown)
    centres = np.stack([shown[i].camera.centre for i in seen])
    (medoid,) = choose_centre_views(centres, np.array([shown[i].hole_share for i in seen]), 1)

    def view_at(step: int) -> int:
        figures(problem, step)
        assert isinstance(problem.guide, Noting)
        return problem.guide.asked.view

    assert {view_at(step) for step in range(4, 10)} == {seen[medoid]}
    assert len({view_at(step) for step in range(10, 26)}) > 1


def test_noise_levels_and_specular_colour_follow_the_global_step(posed: Make) -> None:
    """S9: eta = 0.95 (1 - s / S) at step s, not at s - 4. S10: specular colour grows over the first S / 2 steps."""
    problem = posed()
    for step in (4, 20, 39):
        found = figures(problem, step)
        assert found["t_high"] == pytest.approx(0.95 * (1 - step / 80))
        assert found["t_low"] == pytest.approx(found["t_high"] - 0.2)
        assert found["t_low"] <= found["t"] <= found["t_high"]
        assert found["specular_scale"] == pytest.approx(step / 40)
    floored = figures(posed(estimator={"schedule_steps": 40}), 39)
    assert (floored["t_low"], floored["t_high"], floored["t_floored"]) == (0.02, 0.2, 1.0)


def test_a_step_depends_on_its_seed_step_and_rank_alone(posed: Make) -> None:
    """Asked twice, or after others, a step gives the same; another rank or step another patch (S3, S12)."""
    problem = posed()
    first = figures(problem, 12)
    figures(problem, 13)
    assert figures(problem, 12) == first
    drawn = [problem.terms(step, Ranks(rank, 2))[1]["t"] for step in (12, 13) for rank in (0, 1)]
    assert len(set(drawn)) == 4


def test_a_field_that_is_carried_over_learns_at_a_share_of_the_rate(posed: Make) -> None:
    """N7 from nothing: 1e-2 at the end of the warm-up, 1e-3 at the end, half of that at twice as many steps."""
    problem = posed(optimizer={"learning_rate_warmup": 5, "learning_rate_steps": 20, "warm_start_lr_scale": 0.3})
    rates = [replace(problem, fresh=True).rate(step) for step in (0, 20, 40)]
    assert rates == pytest.approx([2e-3, 1e-3, 0.5e-3])
    assert [replace(problem, fresh=False).rate(step) for step in (0, 20, 40)] == pytest.approx([0.3 * r for r in rates])


def test_sight_lines_are_those_of_the_views_to_fit(room: SyntheticScene) -> None:
    shape = room.object_masks[0].shape
    views = [
        MaskedView(name, camera, np.zeros((*shape, 3), np.float32), np.zeros(shape, bool), np.ones(shape, bool))
        for name, camera in zip(room.names, room.cameras, strict=True)
    ]
    scene = MaskedScene(tuple(views[1:]), (views[0],), room.points, tuple(room.names))
    sighted = trace_sparse_points(scene, "cpu")
    assert sighted is not None
    assert len(sighted) == (room.points.track_frame != 0).sum() > 0
    away = np.linalg.norm(sighted.rays.origins.numpy() - room.cameras[0].centre, axis=1)
    assert away.min() > 1e-3
    none = room.points.select(np.zeros(len(room.points), bool))
    assert trace_sparse_points(MaskedScene(tuple(views[:1]), tuple(views[1:]), none, scene.order), "cpu") is None


class Faulty(Context):
    """At a step, once or whenever it comes, puts a NaN into the field."""

    def watch(self, problem: Problem, step: int, *, again: bool) -> None:
        self.problem, self.step, self.again = problem, step, again

    def progress(self, done: float, total: float, message: str = "", **figures: float) -> None:
        if done == self.step:
            self.step = self.step if self.again else -1
            with torch.no_grad():
                self.problem.field.base.table[7, 1] = torch.nan


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("at", [2, 5])
def test_a_weight_that_breaks_is_located_and_the_loop_goes_back_once(
    posed: Make, tmp_path: Path, at: int, again: bool
) -> None:
    """On the way, and at the last step, where only the check before the commit would see a rare entry."""
    problem, messages = posed(steps=6), []
    work = tmp_path / "work"
    work.mkdir()
    ctx = Faulty(seed=0, device="cpu", threads=1, work=work, emit=lambda event, **v: messages.append(v.get("message")))
    ctx.watch(problem, at, again=again)
    if again:
        with pytest.raises(NonFiniteError, match=r"base\.table \(1, the first at \[7, 1\].*went back 1 times before"):
            optimise(problem, ctx, Curves(), Ranks())
    else:
        optimise(problem, ctx, Curves(), Ranks())
        check_finite(problem.field)
        assert ctx.health["rollbacks"] == 1
        assert sum("base.table (1, the first at [7, 1])" in (m or "") for m in messages) == 1


def test_a_prior_that_breaks_is_told_with_step_view_and_window(posed: Make) -> None:
    problem = posed()
    assert isinstance(problem.guide, Noting)
    with torch.no_grad():
        next(problem.guide.prior.parameters()).fill_(torch.nan)  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(
        BadInputError, match=r"step 12, view view_\d+, window of \d+ px at .*the prior answered \d+ of 768"
    ):
        problem.terms(12, Ranks())


def test_a_hole_without_anything_known_around_is_told_by_its_view(posed: Make) -> None:
    """The hole lies at the left, what is known at the right, and between them is neither."""
    problem = posed()
    columns = np.broadcast_to(np.arange(48), (36, 48))
    far = [replace(view, hole=columns < 8, known=columns == 47) for view in problem.to_fill]
    with pytest.raises(BadInputError, match=r"the hole of view view_\d+ fills every window of \d+ px"):
        replace(problem, to_fill=far).terms(12, Ranks())
