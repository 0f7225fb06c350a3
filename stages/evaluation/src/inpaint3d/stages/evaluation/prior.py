"""What the diffusion prior makes of holes whose truth is known, as it was judged when it was trained."""

from inpaint3d.contracts.models.artifacts import DiffusionPrior, Protocol
from inpaint3d.stages.evaluation.scores import metric

PRIOR = "prior-on-held-out-crops"
TUNED, WIRED = "prior", "prior-before-fine-tuning"
_FILLS = {
    TUNED: "{}_sample",
    WIRED: "start_{}_sample",
    "prior-expectation": "{}_expectation",
    "smooth-fill": "{}_pyramid",
    "telea": "{}_telea",
}
_FIGURES = {"psnr": "hole_psnr", "lpips_vgg": "lpips"}


def held_out_crops(prior: DiffusionPrior) -> list[Protocol]:
    """`prior-on-held-out-crops`: the prior before and after the capture, beside two classical fills, hole by hole."""
    figures, crops = prior.held_out, int(prior.held_out.get("crops", 0))
    metrics = [
        metric(method, name, figures[key], crops)
        for method, pattern in _FILLS.items()
        for name, figure in _FIGURES.items()
        if (key := pattern.format(figure)) in figures
    ]
    if not metrics:
        return []
    return [
        Protocol(
            name=PRIOR,
            description=f"{crops} crops of photos kept out of training, {prior.spec.size} px a side, random holes. "
            f"{TUNED}: one sample for each; {WIRED}: the same of the prior that training began with, where there was "
            "one; prior-expectation: its guess before it has seen any noise; smooth-fill: what its condition shows in "
            "the hole; telea: OpenCV's fast marching. PSNR is taken inside the hole, LPIPS over the crop.",
            metrics=tuple(metrics),
        )
    ]
