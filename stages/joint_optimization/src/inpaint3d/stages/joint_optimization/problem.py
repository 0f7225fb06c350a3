"""What a step of the paper's loop descends: rays, windows of the hole and their weights (rows S1 to S10)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from inpaint3d.contracts.errors import BadInputError, NonFiniteError
from inpaint3d.diffusion.training import step_generators
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.line_of_sight import SightLines
from inpaint3d.radiance.optim import scheduled_rate
from inpaint3d.radiance.tracing import NamedCameras
from inpaint3d.radiance.training import proposal_anneal
from inpaint3d.scene.masked_views import MaskedScene, MaskedView, find_fillable
from inpaint3d.scene.windows import Window, draw_window
from inpaint3d.stages.joint_optimization.batch import Filled, RayBank
from inpaint3d.stages.joint_optimization.centre_views import choose_centre_views
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.distil import Distilled, distil
from inpaint3d.stages.joint_optimization.estimators.base import Guided
from inpaint3d.stages.joint_optimization.guidance import Guide, Timesteps
from inpaint3d.stages.joint_optimization.objective import Terms, step_terms
from inpaint3d.stages.joint_optimization.parallel import Ranks
from inpaint3d.stages.joint_optimization.schedule import centre_views_only, distillation_weight


@dataclass(frozen=True, eq=False)
class Problem:
    """What is optimised, and by what.

    to_fill: the training views with the holes that the guide is to fill. fresh: the field starts from nothing, and
    needs steps of reconstruction alone (S7).
    """

    field: RadianceField
    guide: Guide | None
    scene: MaskedScene
    to_fill: Sequence[MaskedView]
    config: Config
    seed: int
    fresh: bool
    diffuse_start: bool
    filled: Filled | None = None

    @cached_property
    def bank(self) -> RayBank:
        device = str(self.field.device)
        share = getattr(self.config.estimator, "filled_share", 0.0)
        sight_lines = trace_sparse_points(self.scene, device)
        return RayBank(self.scene.train, device, filled=self.filled, filled_share=share, sight_lines=sight_lines)

    @property
    def cameras(self) -> NamedCameras:
        """Of the training views, by name."""
        return [(view.name, view.camera) for view in self.scene.train]

    @property
    def guided(self) -> tuple[Guide, Guided] | None:
        """The guide and the parameters of its estimator; None where nothing pulls the hole."""
        estimator = self.config.estimator
        return (self.guide, estimator) if self.guide is not None and isinstance(estimator, Guided) else None

    @property
    def patches(self) -> int:
        """Patches a step of a rank for depth smoothness (L6)."""
        return self.config.depth_patches if self.config.loss_weights.depth else 0

    def count_rays(self, ranks: Ranks) -> int:
        """Rays to pixels of a step, of all ranks, without those of the distilled window."""
        return self.config.rays + ranks.world_size * self.patches * self.config.depth_patch_size**2

    def since(self, step: int) -> int:
        """Steps since the start of distillation (S6, S8); negative before it, and throughout without a guide."""
        if self.guided is None:
            return -1
        return step - (self.guided[1].warmup_steps if self.fresh else 0)

    def rate(self, step: int) -> float:
        """The learning rate of a step (N7)."""
        optimizer = self.config.optimizer
        scale = 1.0 if self.fresh else optimizer.warm_start_lr_scale
        return scale * scheduled_rate(step, optimizer, self.config.steps)

    def terms(self, step: int, ranks: Ranks) -> tuple[Terms, dict[str, float]]:
        """The weighted terms of a rank at a step, and how strongly the prior pushed.

        They depend on the field, the guide, (seed, step, rank) and nothing else: that a run was stopped and went on, or
        how its ranks share out, never shows.
        """
        config, weights = self.config, self.config.loss_weights
        rng, generator = step_generators(self.seed * ranks.world_size + ranks.rank, step, device=self.field.device)
        distilled, weight, figures = self._distil(step, rng, generator)
        batch = self.bank.draw(
            config.rays // ranks.world_size,
            patches=self.patches,
            patch_size=config.depth_patch_size,
            generator=generator,
            sighted=max(1, config.line_of_sight_rays // ranks.world_size) if weights.line_of_sight else 0,
        )
        anneal = proposal_anneal(step, config.optimizer.proposal_anneal_steps) if self.fresh else 1.0
        terms = step_terms(self.field, batch, distilled, weight, config, anneal=anneal, generator=generator)
        return terms, figures

    def _distil(
        self, step: int, rng: np.random.Generator, generator: torch.Generator
    ) -> tuple[Distilled | None, float, dict[str, float]]:
        since = self.since(step)
        if self.guided is None or since < 0 or since % self.guided[1].distill_every:
            return None, 0.0, {}
        guide, estimator = self.guided
        steps = self.config.steps
        total = steps - (step - since)
        timesteps = estimator.timesteps_at(step, steps)
        weight = distillation_weight(
            since, total, peak=estimator.weight, warmup=estimator.weight_warmup, decay_to=estimator.weight_decay_to
        )
        span = estimator.span_at(since, total)
        specular = estimator.specular_at(step, steps) if self.diffuse_start else 1.0
        window = choose_window(self.to_fill, guide, estimator, since=since, span=span, rng=rng)
        view = self.to_fill[window.view]
        try:
            distilled = distil(
                self.field,
                guide,
                view,
                window,
                timesteps=timesteps,
                specular_scale=specular,
                block=self.config.block,
                generator=generator,
            )
        except (BadInputError, NonFiniteError) as error:
            side = window.spacing * window.size
            where = f"step {step}, view {view.name}, window of {side:.0f} px at ({window.x:.0f}, {window.y:.0f})"
            raise type(error)(f"{where}: {error}") from error
        return distilled, weight, describe_push(distilled, timesteps, weight, span, specular)


def trace_sparse_points(scene: MaskedScene, device: str) -> SightLines | None:
    """The sparse points as the views to fit saw them; None where they saw none."""
    cameras = {v.name: v.camera for v in (*scene.train, *scene.test)}
    fitted = np.isin(scene.order, [v.name for v in scene.train])
    among = fitted[scene.sparse.track_frame]
    if not among.any():
        return None
    return SightLines.of([cameras[name] for name in scene.order], scene.sparse, among, device)


def choose_window(
    views: Sequence[MaskedView], guide: Guide, estimator: Guided, *, since: int, span: float, rng: np.random.Generator
) -> Window:
    """A view that shows the hole (a centre view at first, S8) and a window of it."""
    candidates = find_fillable(views)
    if centre_views_only(since, estimator.centre_steps):
        centres = np.stack([views[i].camera.centre for i in candidates])
        shares = np.array([views[i].hole_share for i in candidates])
        candidates = [candidates[i] for i in choose_centre_views(centres, shares, estimator.centre_views)]
    chosen = candidates[int(rng.integers(len(candidates)))]
    view = views[chosen]
    window = (
        draw_window(view.hole, view.known, chosen, size=guide.size, span=span, min_known=estimator.min_known, rng=rng)
        if guide.windows is None
        else guide.windows[chosen]
    )
    if window is None:
        raise BadInputError(f"view {view.name} has no hole to fill; re-run mask-authoring")
    if estimator.needs_surround and not window.sample(view.known).any():
        raise BadInputError(
            f"the hole of view {view.name} fills every window of {window.spacing * window.size:.0f} px that shows it, "
            "so that nothing known tells what belongs into it; author a smaller mask, or let the windows be larger"
        )
    return window


def describe_push(
    distilled: Distilled, timesteps: Timesteps, weight: float, span: float, specular: float
) -> dict[str, float]:
    """How and how strongly the guide pulled at a step, for terms.csv."""
    times: dict[str, float] = {}
    if timesteps is not None:
        times = {"t_low": timesteps.low, "t_high": timesteps.high, "t_floored": float(timesteps.floored)}
    return {
        "weight": weight,
        "t": distilled.t,
        **times,
        "push": distilled.push,
        "window_span": span,
        "specular_scale": specular,
    }
