"""A baseline: every view sampled from the prior on its own, with one seed (the paper's 'Inpaint-then-NeRF', E4)."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts.completion import SOURCE_CODES
from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.diffusion.samplers import inpaint
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.windows import Window, choose_fixed_windows
from inpaint3d.stages.view_completion.completion import Completion
from inpaint3d.stages.view_completion.config import PriorSamples


def complete_by_samples(
    views: Sequence[MaskedView],
    prior: Denoiser,
    method: PriorSamples,
    *,
    seed: int,
    device: str = "cpu",
    tick: Callable[[int, int, str], None] | None = None,
) -> list[Completion]:
    """One window of each view, over most of its hole, as the prior fills it by ancestral sampling.

    Every view starts from the same noise, is shown the same noise fill, and draws the same noise on the way: as far as
    independent samples can agree, these do. What of a hole lies outside the window stays unfilled. device: the prior's.
    """
    windows = choose_fixed_windows(views, size=prior.size, span=method.span, min_known=method.min_known)
    completions = []
    for index, (view, window) in enumerate(zip(views, windows, strict=True)):
        if tick is not None:
            tick(index, len(views), f"sampling {view.name}")
        if window is None:
            completions.append(Completion(view.name, view.image, np.zeros(view.hole.shape, np.uint16)))
        else:
            made = sample_window(view, window, prior, method, seed=seed, device=device)
            completions.append(paste_window(view, window, made))
    return completions


def sample_window(
    view: MaskedView, window: Window, prior: Denoiser, method: PriorSamples, *, seed: int, device: str
) -> NDArray[np.float32]:
    """The window as the prior fills it, [size, size, 3] in [0, 1]; its known pixels are the photo's."""
    image = torch.from_numpy(np.ascontiguousarray(window.sample(view.image))).to(device) * 2 - 1
    unknown = torch.from_numpy(window.sample(~view.known))[None, None].float().to(device)
    made = inpaint(
        prior,
        image.permute(2, 0, 1)[None],
        unknown,
        steps=method.sample_steps,
        generator=torch.Generator().manual_seed(seed),
        guidance=method.guidance,
        sampler="ddpm",
    )
    return ((made[0].permute(1, 2, 0) + 1) / 2).cpu().numpy()


def paste_window(view: MaskedView, window: Window, made: NDArray[np.float32]) -> Completion:
    """The view with what of its hole lies in the window taken from `made` [size, size, 3]: the cell over each pixel."""
    y, x = np.nonzero(view.hole)
    column = np.floor((x + 0.5 - window.x) / window.spacing).astype(np.int64)
    row = np.floor((y + 0.5 - window.y) / window.spacing).astype(np.int64)
    inside = (column >= 0) & (column < window.size) & (row >= 0) & (row < window.size)
    picture, sources = view.image.copy(), np.zeros(view.hole.shape, np.uint16)
    picture[y[inside], x[inside]] = made[row[inside], column[inside]]
    sources[y[inside], x[inside]] = SOURCE_CODES["prior"]
    return Completion(view.name, picture, sources)
