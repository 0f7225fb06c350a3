"""Parameters of view completion. Defaults: the `standard` preset, for two CPU cores."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field
from pydantic.config import JsonDict

from inpaint3d.contracts.models.base import Closed, Finite, Share

Count = Annotated[int, Field(ge=1)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class PhotoCompletion(Closed):
    """What other photos show is taken from them; the rest is made up by example in a few views, and carried in 3D."""

    name: Literal["photo-completion"] = "photo-completion"
    min_supporting_views: Count = Field(
        default=2, description="other photos that must show a surface for it to be taken from them"
    )
    max_reference_views: Count = Field(
        default=4, description="views in which what no photo shows is made up, at most; painted ones are not counted"
    )
    variety: Weight = Field(
        default=0.0,
        description="by which share less alike than the best a patch may be that is copied; more than 0 makes the "
        "fill depend on the seed",
    )


class Classical(Closed):
    """Every view on its own, by Telea's method (2004): a baseline."""

    name: Literal["classical"] = "classical"


class PriorSamples(Closed):
    """Every view on its own, sampled from a prior with one seed: the paper's baseline 'Inpaint-then-NeRF' (E4)."""

    name: Literal["prior-samples"] = "prior-samples"
    sample_steps: Count = Field(default=32, description="ancestral steps for each view; 1000 in the paper")
    guidance: Finite = Field(default=1.0, description="g in eps_null + g (eps_cond - eps_null) (S5)")
    prompt: str = Field(
        default="",
        description="what a diffusers pipeline that takes text is told of the picture",
        json_schema_extra={"x-with": "diffusers-pipeline"},
    )
    span: Share = Field(default=0.75, description="side of the window that is sampled, share of the short side (S1)")
    min_known: Share = Field(default=0.2, description="share of it that is known, where a view has such (S1)")
    hole: Literal["as-masked", "unseen"] = Field(
        default="unseen", description="what is filled: all that is masked, or what other views do not show"
    )
    min_supporting_views: Count = Field(
        default=2,
        description="unseen: other views that must know a surface",
        json_schema_extra={"x-under": {"hole": "unseen"}},
    )


READS: JsonDict = {
    "photo-completion": ["painted-views"],
    "classical": [],
    "prior-samples": ["diffusers-pipeline|diffusion-prior"],
}
"""The optional ports that each method reads; a|b: the first that is wired."""


def _check_named(given: Any) -> Any:
    return {"name": given} if isinstance(given, str) else given


class Config(Closed):
    """How the hole is filled."""

    method: Annotated[
        PhotoCompletion | Classical | PriorSamples, Field(discriminator="name"), BeforeValidator(_check_named)
    ] = Field(default=PhotoCompletion(), description="how the hole is filled", json_schema_extra={"x-reads": READS})
