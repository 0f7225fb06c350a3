"""The prior sees diffuse colour first, the rest is blended in (the paper, row S10 of docs/conformance.md)."""

from inpaint3d.scene.effects.description import Description

EFFECT = Description(
    name="diffuse-only-start",
    what="distillation that begins with diffuse colour",
    evidence="a prior is asked, and the field has view-dependent colour",
    off_means="the prior sees the whole colour from the first step on",
    simulated_by="inpaint3d.stages.joint_optimization.schedule.specular_scale",
    parameter="joint-optimization.estimator.diffuse_start",
)
