"""One step of distillation: render a window, ask the prior, hand its gradient to the field (rows S1 to S5, S10, L7)."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.health import find_non_finite
from inpaint3d.radiance.losses import distortion_loss, interlevel_loss
from inpaint3d.radiance.rays import Rays, camera_rays
from inpaint3d.radiance.rendering import Rendering, render
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.windows import Window
from inpaint3d.stages.joint_optimization.guidance import Guide, Timesteps


@dataclass(frozen=True)
class Distilled:
    """What a patch adds to the step.

    surrogate: a number whose gradient is the guide's; its value means nothing. interlevel, distortion: means over the
    rays of the hole, `rays` of them. t: the diffusion time, NaN where there is none. push: root mean square of the
    gradient inside the hole.
    """

    surrogate: Float[Tensor, ""]
    interlevel: Float[Tensor, ""]
    distortion: Float[Tensor, ""]
    rays: int
    t: float
    push: float


def distil(
    field: RadianceField,
    guide: Guide,
    view: MaskedView,
    window: Window,
    *,
    timesteps: Timesteps,
    specular_scale: float,
    block: int,
    generator: torch.Generator,
) -> Distilled:
    """Render the window with the mean appearance code and pull its hole towards what the prior believes.

    Behind the field lies one random colour: what it shines through is never what the prior asked for, so that the hole
    becomes opaque.

    The gradient is 0 outside the hole, so that only the rays inside are rendered with a graph: known pixels cost a
    plain render, or nothing where the guide does not look at them, and nothing is rendered twice unless the hole has
    more than `block` rays.
    """
    rays = camera_rays(view.camera, window.pixels(), device=field.device)
    hole = torch.from_numpy(window.sample(view.hole)).to(field.device)
    inside = Rays(rays.origins[hole], rays.directions[hole])
    behind = torch.rand(3, generator=generator, device=generator.device).to(field.device)
    look = Look(specular_scale, behind)
    rgb, interlevel, distortion = _render_with_graph(field, inside, look, block, generator)
    patch = torch.zeros(*hole.shape, 3, device=field.device)
    if guide.needs_surround:
        outside = Rays(rays.origins[~hole], rays.directions[~hole])
        patch[~hole] = _render_without_graph(field, outside, look, block)
    patch[hole] = rgb.detach()
    gradient, t = guide.gradient(patch, hole, window, timesteps, generator)
    inner = gradient[hole]
    if found := find_non_finite({"its gradient": inner}):
        raise NonFiniteError(f"the guide of view {view.name} answered what is not finite: {found[0]}, at t = {t:.3f}")
    return Distilled(
        # The gradient is a constant: the surrogate's derivative by the patch is exactly it.
        surrogate=(rgb * inner).sum(),
        interlevel=interlevel,
        distortion=distortion,
        rays=len(inside.origins),
        t=t,
        push=float(inner.square().mean().sqrt()),
    )


class Look(NamedTuple):
    """How a patch is shown to the prior."""

    specular_scale: float
    behind: Float[Tensor, " 3"]  # colour behind the field


def _render(field: RadianceField, rays: Rays, look: Look, jitter: torch.Generator | None = None) -> Rendering:
    return render(
        field,
        rays,
        generator=jitter,
        glo="mean",
        specular_scale=look.specular_scale,
        background=look.behind.expand(len(rays.origins), 3),
        near_gradient=False,
    )


@torch.no_grad()
def _render_without_graph(field: RadianceField, rays: Rays, look: Look, block: int) -> Float[Tensor, "n 3"]:
    colours = [_render(field, rays[i : i + block], look).rgb for i in range(0, len(rays.origins), block)]
    return torch.cat(colours) if colours else rays.origins.new_zeros(0, 3)


def _render_with_graph(
    field: RadianceField, rays: Rays, look: Look, block: int, generator: torch.Generator
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, ""], Float[Tensor, ""]]:
    """Colours of rays and their regularisers' means. Beyond one block, blocks are rendered again when it is their turn
    to backpropagate: a third more time, and the memory of one block.
    """
    count = len(rays.origins)
    seeds = torch.randint(2**62, (-(-count // block),), generator=generator, device=generator.device).tolist()

    def part(start: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
        some = rays[start : start + block]
        # Seeded here, so that the second rendering jitters its samples as the first did.
        jitter = torch.Generator(generator.device).manual_seed(seed)
        seen = _render(field, some, look, jitter)
        share = len(some.origins) / count
        return seen.rgb, share * interlevel_loss(seen), share * distortion_loss(seen)

    starts = range(0, count, block)
    if len(seeds) == 1:
        return part(0, seeds[0])
    parts = [
        checkpoint(part, start, seed, use_reentrant=False, preserve_rng_state=False)
        for start, seed in zip(starts, seeds, strict=True)
    ]
    rgb, interlevel, distortion = zip(*parts, strict=True)
    return torch.cat(rgb), torch.stack(interlevel).sum(), torch.stack(distortion).sum()
