"""A guide that needs no training: features of the hole are matched with those of known pixels of other views."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from inpaint3d.perception.matching import Cells, cells, join_cells, nearest_mismatch, sliced_mismatch
from inpaint3d.scene.masked_views import MaskedView, find_fillable
from inpaint3d.scene.windows import Window, draw_window
from inpaint3d.stages.joint_optimization.guidance import Hole, Patch, Stateless, Timesteps


class FeatureGuide(Stateless):
    """Matches the patch's hole with known pixels around the holes of other views, in windows as large as its own.

    Windows narrow over the run (S1), so that it goes from coarse to fine.
    """

    windows = None
    needs_surround = True

    def __init__(
        self,
        views: Sequence[MaskedView],
        *,
        size: int,
        matching: Literal["nearest", "sliced"],
        reference_windows: int,
        min_known: float,
    ) -> None:
        self.size = size
        self._views, self._shown = views, find_fillable(views)
        self._matching, self._reference_windows, self._min_known = matching, reference_windows, min_known

    def gradient(
        self,
        patch: Patch,
        hole: Hole,
        window: Window,
        timesteps: Timesteps,  # noqa: ARG002 - nothing is noised here
        generator: torch.Generator,
    ) -> tuple[Patch, float]:
        rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
        others = [i for i in self._shown if i != window.view] or self._shown
        known = join_cells([self._cut_reference(others[int(rng.integers(len(others)))], window, patch, rng)
                        for _ in range(self._reference_windows)])  # fmt: skip
        rendered = patch.detach().requires_grad_()
        made = cells(rendered.permute(2, 0, 1)[None] * 2 - 1, hole, whole=False)
        loss = nearest_mismatch(made, known) if self._matching == "nearest" else sliced_mismatch(made, known, generator)
        (gradient,) = torch.autograd.grad(loss, rendered)
        return gradient * hole[..., None], float("nan")

    @torch.no_grad()
    def _cut_reference(self, index: int, window: Window, patch: Tensor, rng: np.random.Generator) -> Cells:
        view = self._views[index]
        span = window.spacing * window.size / min(view.hole.shape)
        found = draw_window(view.hole, view.known, index, size=self.size, span=span, min_known=self._min_known, rng=rng)
        if found is None:
            raise ValueError(f"view {view.name} shows no hole to look around")
        image = torch.from_numpy(np.ascontiguousarray(found.sample(view.image))).to(patch)
        known = torch.from_numpy(found.sample(view.known)).to(patch.device)
        return cells(image.permute(2, 0, 1)[None] * 2 - 1, known, whole=True)
