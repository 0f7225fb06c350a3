"""Whether anything is made up by a prior at all."""

from inpaint3d.scene.effects.description import Description

EFFECT = Description(
    name="prior",
    what="a diffusion prior that makes up what no photo shows",
    evidence="whether the completion or the estimator asks one, and whether any pixel is seen by no other view",
    off_means="no prior is trained or read; what photos show is copied, the rest continued by example",
    simulated_by="inpaint3d.diffusion.loading.load_denoiser",
    parameter="view-completion.method",
)
