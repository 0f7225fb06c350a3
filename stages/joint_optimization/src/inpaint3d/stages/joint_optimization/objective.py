"""The total loss of a step, term by term (the paper's L_total; rows L1 to L8)."""

from collections.abc import Mapping

import torch
from torch import Tensor

from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.line_of_sight import line_of_sight_loss
from inpaint3d.radiance.losses import (
    charbonnier,
    depth_smoothness_loss,
    distortion_loss,
    hash_decay,
    interlevel_loss,
)
from inpaint3d.radiance.rendering import BACKGROUND, render
from inpaint3d.stages.joint_optimization.batch import Batch
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.distil import Distilled

Terms = dict[str, Tensor]
TERMS = ("reconstruction", "interlevel", "distortion", "line_of_sight", "depth", "hash_decay", "distillation")
"""Every term that a step may have."""


def step_terms(
    field: RadianceField,
    batch: Batch,
    distilled: Distilled | None,
    weight: float,
    config: Config,
    *,
    anneal: float,
    generator: torch.Generator | None,
) -> Terms:
    """The weighted terms; what the step descends is their sum and the tables' decay, which the optimiser adds (N9).

    `weight` is that of distillation at this step (S6).

    generator jitters the samples along rays, and colours what lies behind the known ones: a background that nothing
    can imitate makes what the photos show opaque. None centres the samples, before grey.

    Reconstruction sees known pixels alone (L2). The regularisers see every ray of the step, masked ones and those of
    the distilled hole too (L7): their means are over all of them. A term of weight 0 is not computed.
    """
    weights = config.loss_weights
    known, total = len(batch.target), len(batch.rays.origins)
    background = batch.target.new_full((total, 3), BACKGROUND)
    if generator is not None:
        background[:known] = torch.rand(known, 3, generator=generator, device=generator.device).to(batch.target)
    seen = render(
        field,
        batch.rays,
        generator=generator,
        background=background,
        anneal=anneal,
        near_gradient=config.optimizer.near_gradient,
    )
    terms: Terms = {"reconstruction": weights.reconstruction * charbonnier(seen.rgb[:known] - batch.target).mean()}
    share = distilled.rays / (total + distilled.rays) if distilled else 0.0
    if weights.interlevel:
        here = interlevel_loss(seen)
        both = here if distilled is None else (1 - share) * here + share * distilled.interlevel
        terms["interlevel"] = weights.interlevel * both
    if weights.distortion:
        here = distortion_loss(seen)
        both = here if distilled is None else (1 - share) * here + share * distilled.distortion
        terms["distortion"] = weights.distortion * both
    if weights.line_of_sight and len(batch.distance):
        terms["line_of_sight"] = weights.line_of_sight * line_of_sight_loss(seen, batch.sighted, batch.distance)
    if weights.depth:
        p, h, w = batch.patches
        depth, rgb = seen.depth[-p * h * w :].reshape(p, h, w), seen.rgb[-p * h * w :].reshape(p, h, w, 3)
        terms["depth"] = weights.depth * depth_smoothness_loss(depth, rgb)
    if distilled is not None and weight > 0:
        terms["distillation"] = weight * distilled.surrogate
    return terms


def decay_term(field: RadianceField, config: Config) -> Terms:
    """What the optimiser descends beside the terms of a step (N9), as a term."""
    return {"hash_decay": config.loss_weights.hash_decay * hash_decay(field)}


def gradient_norms(field: RadianceField, terms: Mapping[str, Tensor]) -> dict[str, float]:
    """Euclidean norm over all parameters of each term's gradient (L8), 0 for a term that has none at this step.

    Keeps the graph: as dear as a step a term.
    """
    parameters = list(field.parameters())
    norms: dict[str, float] = {}
    for name, term in terms.items():
        if not term.requires_grad:
            norms[name] = 0.0
            continue
        gradients = torch.autograd.grad(term, parameters, retain_graph=True, allow_unused=True)
        squares = [g.square().sum() for g in gradients if g is not None]
        norms[name] = float(torch.stack(squares).sum().sqrt())
    return norms
