"""Gaussians as tensors, and the choice of what draws them."""

from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d.scene.cameras import Camera

NEAR = 0.05
"""Depth in scene units up to which a splat is not seen: the affine approximation of eq. 5 fails at the camera."""


@dataclass(frozen=True, eq=False)
class Splats:
    """n Gaussians in the world, float32; colours are the same from everywhere (degree 0), sRGB-encoded."""

    mean: Float[Tensor, "n 3"]
    """Scene units."""
    log_scale: Float[Tensor, "n 3"]
    """Of the standard deviation along each of its own axes, scene units."""
    rotation: Float[Tensor, "n 4"]
    """World from its own axes: quaternions w, x, y, z of any length."""
    opacity: Float[Tensor, " n"]
    """Logits."""
    rgb: Float[Tensor, "n 3"]

    def __len__(self) -> int:
        return len(self.mean)

    def named(self) -> dict[str, Tensor]:
        """The tensors by name, in the order of the fields."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        return tuple(self.named().values())

    def map(self, change: Any) -> "Splats":
        """The same with `change` applied to every tensor."""
        return replace(self, **{name: change(tensor) for name, tensor in self.named().items()})


@dataclass(frozen=True, eq=False)
class View:
    """A camera as the rasterisers take it: fx, fy, cx, cy and size in pixels."""

    intrinsics: tuple[float, float, float, float]
    width: int
    height: int
    cam_from_world: Float[Tensor, "3 4"]

    @classmethod
    def of(cls, camera: Camera) -> "View":
        pose = torch.from_numpy(camera.cam_from_world).float().contiguous()
        return cls((camera.fx, camera.fy, camera.cx, camera.cy), camera.width, camera.height, pose)


def render_splats(splats: Splats, view: View) -> Float[Tensor, "h w 3"]:
    """What a camera sees of splats before black; differentiable in every tensor of them."""
    return _select().render_splats(splats, view)


def has_kernels() -> bool:
    """Whether the CPU's kernels draw; the reference is for pictures of a few hundred splats."""
    return _select().__name__.endswith(".native")


@cache
def _select() -> Any:
    try:
        from inpaint3d.radiance.splats import native
    except ImportError:
        from inpaint3d.radiance.splats import reference

        return reference
    return native
