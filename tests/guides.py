"""Guides of estimators, for tests that have a prior in hand."""

from typing import Any

from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.stages.joint_optimization.estimators import ESTIMATORS
from inpaint3d.stages.joint_optimization.estimators.base import PriorEstimator
from inpaint3d.stages.joint_optimization.guidance import PriorGuide


def prior_estimator(name: str, *, steps: int = 1, **parameters: Any) -> PriorEstimator:
    """An estimator that asks a prior. steps: of denoising or inversion, for those that take any."""
    kind = ESTIMATORS[name]
    counts = {n: steps for n in ("denoise_steps", "inversion_steps") if n in kind.model_fields}
    estimator = kind.model_validate({**counts, **parameters})
    assert isinstance(estimator, PriorEstimator)
    return estimator


def make_prior_guide(name: str, prior: Denoiser, *, steps: int = 1, **parameters: Any) -> PriorGuide:
    guide = prior_estimator(name, steps=steps, **parameters).guide_by(prior, (), 0)
    assert isinstance(guide, PriorGuide)
    return guide
