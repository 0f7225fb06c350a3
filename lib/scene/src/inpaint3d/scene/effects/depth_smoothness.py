"""Smooth depth where patches are drawn (RegNeRF; row L6 of docs/conformance.md)."""

from inpaint3d.scene.effects.description import Description

EFFECT = Description(
    name="depth-smoothness",
    what="smooth depth in patches of neighbouring rays",
    evidence="none is measured: its weight is a parameter",
    off_means="weight 0: no patch is rendered for it",
    simulated_by="inpaint3d.radiance.losses.depth_smoothness_loss",
    parameter="joint-optimization.loss_weights.depth",
)
