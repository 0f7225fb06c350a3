"""Baselines that fill the pictures before there is a field: by OpenCV, or by the prior, each view on its own (E4)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.diffusion.samplers import inpaint
from inpaint3d.perception.lpips import enlarge, load
from inpaint3d.stages.joint_optimization.guidance import Hole, Patch, Stateless, Windows
from inpaint3d.stages.joint_optimization.patches import Window, draw_window
from inpaint3d.stages.joint_optimization.scene import SceneView
from inpaint3d.stages.joint_optimization.texture import telea


def filled_classically(views: Sequence[SceneView]) -> tuple[SceneView, ...]:
    """The views with their holes filled by Telea's method (2004) from their own known pixels, and no hole any more."""
    return tuple(
        replace(
            v,
            image=np.where(v.hole[..., None], telea(v.image, ~v.known), v.image),
            known=v.known | v.hole,
            hole=np.zeros_like(v.hole),
        )
        for v in views
    )


def fixed_windows(views: Sequence[SceneView], *, size: int, span: float, least_known: float) -> Windows:
    """One window of each view, over most of its hole; None where it shows none, or nothing known around it."""
    return [
        draw_window(v.hole, v.known, i, size=size, span=span, least_known=least_known, rng=None)
        if v.known.any()
        else None
        for i, v in enumerate(views)
    ]


def sampled_views(
    views: Sequence[SceneView],
    windows: Windows,
    prior: Denoiser,
    *,
    steps: int,
    guidance: float,
    seed: int,
    device: str = "cpu",
) -> list[Tensor | None]:
    """Each view's window as the prior fills it, [size, size, 3] in [0, 1], by ancestral sampling.

    Every view starts from the same noise, is shown the same noise fill, and draws the same noise on the way: as far as
    independent samples can agree, these do (the paper's appendix, 'Inpaint-then-NeRF'). device: the prior's.
    """
    pictures: list[Tensor | None] = []
    for view, window in zip(views, windows, strict=True):
        if window is None:
            pictures.append(None)
            continue
        image = torch.from_numpy(np.ascontiguousarray(window.look_up(view.image))).to(device) * 2 - 1
        unknown = torch.from_numpy(window.look_up(~view.known))[None, None].float().to(device)
        made = inpaint(
            prior,
            image.permute(2, 0, 1)[None],
            unknown,
            steps=steps,
            generator=torch.Generator().manual_seed(seed),
            guidance=guidance,
            sampler="ddpm",
        )
        pictures.append((made[0].permute(1, 2, 0) + 1) / 2)
    return pictures


class PictureGuide(Stateless):
    """Pictures that were made beforehand: LPIPS of the hole, the rest of the patch being the picture's own."""

    span = None

    def __init__(self, pictures: Sequence[Tensor | None], windows: Windows, size: int) -> None:
        self.windows, self.size, self._pictures = windows, size, pictures

    def gradient(
        self,
        patch: Patch,
        hole: Hole,
        window: Window,
        timesteps: tuple[float, float],  # noqa: ARG002 - nothing is noised here
        generator: torch.Generator,  # noqa: ARG002 - nor drawn
    ) -> tuple[Patch, float]:
        picture = self._pictures[window.view]
        if picture is None:
            raise ValueError(f"view {window.view} has no picture: it shows no hole")
        return _likeness_gradient(patch, hole, picture), float("nan")


class ReferenceGuide(Stateless):
    """Whole pictures that agree with each other (`reference.completed`): LPIPS of the hole in any window of them.

    It sharpens what rays are fitted to pixel by pixel. Windows are small, since detail is what it is for.
    """

    windows, span = None, 0.3
    STRENGTH = 3.0
    """Times LPIPS, so that the weight that suits the priors suits it."""

    def __init__(self, pictures: Sequence[NDArray[np.float32]], size: int) -> None:
        self.size, self._pictures = size, pictures

    def gradient(
        self,
        patch: Patch,
        hole: Hole,
        window: Window,
        timesteps: tuple[float, float],  # noqa: ARG002 - nothing is noised here
        generator: torch.Generator,  # noqa: ARG002 - nor drawn
    ) -> tuple[Patch, float]:
        picture = torch.from_numpy(np.ascontiguousarray(window.look_up(self._pictures[window.view]))).to(patch)
        return self.STRENGTH * _likeness_gradient(patch, hole, picture), float("nan")


def _likeness_gradient(patch: Patch, hole: Hole, picture: Patch) -> Patch:
    """d(LPIPS to the picture)/d(patch), the patch's known part being the picture's own."""
    rendered = patch.detach().requires_grad_()
    pair = torch.stack([torch.where(hole[..., None], rendered, picture), picture])
    made, wanted = enlarge(pair.permute(0, 3, 1, 2) * 2 - 1).split(1)
    (gradient,) = torch.autograd.grad(load("vgg").difference(made, wanted).sum(), rendered)
    return gradient
