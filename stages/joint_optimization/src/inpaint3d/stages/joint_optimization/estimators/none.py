"""Nothing fills the hole: reconstruction and regularisers alone."""

from typing import Literal

from inpaint3d.stages.joint_optimization.estimators.base import Estimator, Preparation, Setting


class NoEstimator(Estimator):
    """Reconstruction only: a baseline, and the start of the others."""

    name: Literal["none"] = "none"

    def label(self, *, continued: bool, completion: str | None) -> str:  # noqa: ARG002 - none is looked at
        return "continued-reconstruction" if continued else "masked-reconstruction"

    def prepare(self, setting: Setting) -> Preparation:
        return Preparation(setting.scene.train)
