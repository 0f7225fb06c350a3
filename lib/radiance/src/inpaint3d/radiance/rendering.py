"""From rays to colours, opacity and depth: where to ask, the field, and volume rendering."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from inpaint3d.radiance import safe
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rays import Rays, camera_rays
from inpaint3d.radiance.volume import alpha_weights, median_distance
from inpaint3d.scene.cameras import Camera

# A ray of less opacity has met no surface: its depth is the far end.
EMPTY = 1e-3
# What is seen through a field that is not opaque.
BACKGROUND = 0.5


@dataclass(frozen=True)
class Rendering:
    """What rays saw. Depths are distances along unit rays in scene units; empty rays end at `far`.

    What is not finite in the field is not finite here: nothing turns it into a surface, or into none.
    """

    rgb: Float[Tensor, "*n 3"]
    diffuse: Float[Tensor, "*n 3"]
    opacity: Float[Tensor, "*n"]
    depth: Float[Tensor, "*n"]  # expected distance
    median_depth: Float[Tensor, "*n"]  # no gradient
    weights: Float[Tensor, "*n s"]
    sdist: Float[Tensor, "*n ends"]
    tdist: Float[Tensor, "*n ends"]
    proposals: list[tuple[Tensor, Tensor]]  # (sdist [*n, p + 1], weights [*n, p]) of each proposal round


def render(
    field: RadianceField,
    rays: Rays,
    *,
    generator: torch.Generator | None = None,
    glo: Literal["view", "mean"] = "view",
    specular_scale: float = 1.0,
    background: Float[Tensor, "*n 3"] | float = BACKGROUND,
    anneal: float = 1.0,
    near_gradient: bool = True,
) -> Rendering:
    """Render rays of any shape (N2, N10, N11).

    With a generator, samples are jittered and a density grid notices them (training); without, they are centred and the
    result repeats. glo: each ray's
    own appearance code, or the mean of all. anneal: power on the proposals' weights before they are resampled (Mip-NeRF
    360: from 0, even sampling, to 1 over the first steps). near_gradient False turns the gradients down close to the
    camera (see `damp_near_camera`).
    """
    shape, flat = rays.shape, rays.flatten()
    sdist, proposals = _propose(field, flat, generator, anneal)
    tdist = field.spacing.metric_from_normalised(sdist)
    r, s = len(sdist), sdist.shape[1] - 1
    appearance = field.appearance(flat.view, glo)
    points = _find_points(flat, tdist)
    samples = field.query(points, flat.directions, appearance, specular_scale)
    if field.density_grid is not None and generator is not None:
        field.density_grid.notice(field.cube(points), samples.density)
    density, rgb = samples.density.reshape(r, s), samples.rgb.reshape(r, s, 3)
    if not near_gradient:
        density, rgb = damp_near_camera(density, rgb, tdist)
    weights, colour, opacity, depth_sum = field.backend.composite(density, rgb, tdist)
    missing = (1 - opacity)[:, None]
    behind = missing * (background.reshape(r, 3) if isinstance(background, Tensor) else background)
    diffuse = torch.bmm(weights[:, None], samples.diffuse.reshape(r, s, 3))[:, 0]
    return Rendering(
        rgb=(colour + behind).reshape(*shape, 3),
        diffuse=(diffuse + behind).reshape(*shape, 3),
        opacity=opacity.reshape(shape),
        depth=safe.divide(depth_sum, opacity, otherwise=field.spec.far, smallest=EMPTY).reshape(shape),
        median_depth=median_distance(weights, tdist, field.spec.far, EMPTY).reshape(shape),
        weights=weights.reshape(*shape, s),
        sdist=sdist.reshape(*shape, s + 1),
        tdist=tdist.reshape(*shape, s + 1),
        proposals=[(ends.reshape(*shape, -1), w.reshape(*shape, -1)) for ends, w in proposals],
    )


def _propose(
    field: RadianceField, rays: Rays, generator: torch.Generator | None, anneal: float
) -> tuple[Tensor, list[tuple[Tensor, Tensor]]]:
    """Where to ask the field: sdist [r, samples + 1], and each round's histogram."""
    r, device = len(rays.origins), rays.origins.device
    proposals: list[tuple[Tensor, Tensor]] = []
    if field.density_grid is not None:
        sdist, weights = field.density_grid.histogram(field.backend, rays.origins, rays.directions)
        rounds = ()
    else:
        sdist = torch.tensor([0.0, 1.0], device=device).expand(r, 2)
        weights = torch.ones(r, 1, device=device)
        rounds = field.spec.proposal_samples
    for level, count in enumerate((*rounds, field.spec.samples)):
        jitter = None
        if generator is not None:
            jitter = torch.rand(r, count, generator=generator, device=generator.device).to(device)
        mass = weights.detach() if anneal == 1 else weights.detach() ** anneal
        sdist = field.backend.resample(sdist.contiguous(), mass, count, jitter)
        if level == len(rounds):
            break
        tdist = field.spacing.metric_from_normalised(sdist)
        density = field.proposal_density(_find_points(rays, tdist)).reshape(r, count)
        weights = alpha_weights(density, tdist)
        proposals.append((sdist, weights))
    return sdist, proposals


def _find_points(rays: Rays, tdist: Float[Tensor, "r s"]) -> Float[Tensor, "_ 3"]:
    """The middles of intervals, ray after ray."""
    middle = (tdist[:, 1:] + tdist[:, :-1]) / 2
    return torch.addcmul(rays.origins[:, None], rays.directions[:, None], middle[..., None]).reshape(-1, 3)


def damp_near_camera(
    density: Float[Tensor, "r s"], rgb: Float[Tensor, "r s 3"], tdist: Float[Tensor, "r s+1"]
) -> tuple[Float[Tensor, "r s"], Float[Tensor, "r s 3"]]:
    """The same values, their gradients times min(1, t^2) (Philip and Deschaintre 2023, arXiv:2305.02756).

    Space near cameras is sampled t^-2 times as densely as the rest, and gathers floaters.
    """
    middle = ((tdist[:, 1:] + tdist[:, :-1]) / 2).detach()
    share = middle.square().clamp(max=1)
    scaled: Any = _GradientTimes.apply
    return scaled(density, share), scaled(rgb, share[..., None])


class _GradientTimes(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, share: Tensor) -> Tensor:
        ctx.save_for_backward(share)
        return x.view_as(x)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        (share,) = ctx.saved_tensors
        return grads[0] * share, None


@torch.no_grad()
def render_view(
    field: RadianceField,
    camera: Camera,
    *,
    block: int = 4096,
    specular_scale: float = 1.0,
    view: int | None = None,
) -> dict[str, NDArray[np.float32]]:
    """A whole picture, `block` rays at a time: rgb, diffuse [h, w, 3] in [0, 1]; opacity, depth, median_depth [h, w].

    Both depths are along the optical axis, in scene units. The appearance is the mean code's, or that of `view`.
    """
    rays = camera_rays(camera, view=view, device=field.device).flatten()
    names = ("rgb", "diffuse", "opacity", "depth", "median_depth")
    parts: dict[str, list[Tensor]] = {name: [] for name in names}
    for start in range(0, len(rays.origins), block):
        seen = render(field, rays[start : start + block], specular_scale=specular_scale)
        for name in names:
            parts[name].append(getattr(seen, name).cpu())
    maps = {name: torch.cat(tensors).numpy() for name, tensors in parts.items()}
    cosine = rays.directions.cpu().numpy() @ camera.forward.astype(np.float32)
    hw = (camera.height, camera.width)
    return {
        "rgb": maps["rgb"].reshape(*hw, 3).clip(0, 1),
        "diffuse": maps["diffuse"].reshape(*hw, 3).clip(0, 1),
        "opacity": maps["opacity"].reshape(hw),
        "depth": (maps["depth"] * cosine).reshape(hw),
        "median_depth": (maps["median_depth"] * cosine).reshape(hw),
    }
