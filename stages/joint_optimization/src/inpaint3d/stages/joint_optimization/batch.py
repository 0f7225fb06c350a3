"""The rays of a step that need no prior: random pixels, masked ones too, and patches for depth (L2, L6, L7)."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d.radiance.line_of_sight import SightLines
from inpaint3d.radiance.rays import CameraStack, Rays, join_rays
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.masked_views import MaskedView


@dataclass(frozen=True)
class Batch:
    """All rays of a step in one row: known pixels first (made-up ones last among them), then masked ones, then those to
    sparse points and to made-up surfaces, then patches.

    target: colours [k, 3] of the first k rays; distance [m]: to the points and surfaces, scene units; patches:
    (p, h, w) of the last p * h * w rays.
    """

    rays: Rays
    target: Float[Tensor, "k 3"]
    distance: Float[Tensor, " m"]
    patches: tuple[int, int, int]

    @property
    def sighted(self) -> slice:
        """Which rays lead to sparse points and made-up surfaces."""
        p, h, w = self.patches
        end = len(self.rays.origins) - p * h * w
        return slice(end - len(self.distance), end)


@dataclass(frozen=True)
class Filled:
    """What was made up: the views again, their holes (what was filled) in their pictures, and the surfaces there as the
    views see them, where there are any.
    """

    views: Sequence[MaskedView]
    surfaces: SightLines | None


class RayBank:
    """Draws batches. Random rays are uniform over all existing pixels of all views, as in the paper.

    filled: what was made up; of each batch the share `filled_share` shows it (None: its share of the pixels that have a
    colour), in place of masked rays that nothing is known of. sight_lines: of sparse points by these views; as many
    rays go to the surfaces that were made up.
    """

    def __init__(
        self,
        views: Sequence[MaskedView],
        device: str,
        *,
        filled: Filled | None = None,
        filled_share: float | None = 0.0,
        sight_lines: SightLines | None = None,
    ) -> None:
        self._sight_lines = [s for s in (sight_lines, filled.surfaces if filled else None) if s]
        cameras = [v.camera for v in views]
        self._known = Pixels.of(cameras, [v.image for v in views], [v.known for v in views], device)
        self._filled, hidden = None, [v.hole for v in views]
        if filled and any(v.hole.any() for v in filled.views):
            holes = [v.hole for v in filled.views]
            self._filled = Pixels.of(cameras, [v.image for v in filled.views], holes, device)
            hidden = [mask & ~hole for mask, hole in zip(hidden, holes, strict=True)]
        # The colours that ride along are blank: the scene holds nothing under the mask.
        masked = any(mask.any() for mask in hidden)
        self._masked = Pixels.of(cameras, [v.image for v in views], hidden, device) if masked else None
        self._filled_share = filled_share if filled_share is not None else self._share_of(self._filled)
        self._cameras = CameraStack.of(cameras, device)
        self._sizes = torch.tensor([[c.width, c.height] for c in cameras], device=device)

    def draw(self, count: int, *, patches: int, patch_size: int, generator: torch.Generator, sighted: int = 0) -> Batch:
        """`count` random rays, `sighted` to sparse points and as many to made-up surfaces, `patches` squares of
        neighbouring pixels of random views.
        """
        hidden = round(count * self._share_of(self._masked))
        made_up = round(count * self._filled_share) if self._filled else 0
        known, target = self._known.draw(max(1, count - hidden - made_up), generator)
        parts = [known]
        if self._filled and made_up:
            rays, colours = self._filled.draw(made_up, generator)
            parts.append(rays)
            target = torch.cat([target, colours])
        if self._masked and hidden:
            parts.append(self._masked.draw(hidden, generator)[0])
        toward = [sight_lines.draw(sighted, generator) for sight_lines in self._sight_lines if sighted]
        parts += [sight_lines.rays for sight_lines in toward]
        distance = torch.cat([target.new_empty(0), *(sight_lines.distance for sight_lines in toward)])
        if patches:
            parts.append(self._draw_patches(patches, patch_size, generator))
        return Batch(join_rays(parts), target, distance, (patches, patch_size, patch_size))

    def look(self, count: int, generator: torch.Generator) -> Rays:
        """`count` random rays of known pixels."""
        return self._known.draw(count, generator)[0]

    def _share_of(self, some: Pixels | None) -> float:
        """Share of some pixels among those and the known ones."""
        return len(some) / (len(some) + len(self._known)) if some else 0.0

    def _draw_patches(self, count: int, size: int, generator: torch.Generator) -> Rays:
        drawn_on, device = generator.device, self._sizes.device
        view = torch.randint(len(self._sizes), (count,), generator=generator, device=drawn_on).to(device)
        room = (self._sizes[view] - size).clamp(min=0) + 1
        corner = (torch.rand(count, 2, generator=generator, device=drawn_on).to(device) * room).floor()
        steps = torch.arange(size, device=device) + 0.5
        square = torch.stack(torch.meshgrid(steps, steps, indexing="xy"), -1)
        xy = (corner[:, None, None] + square).reshape(-1, 2)
        return self._cameras.rays(view.repeat_interleave(size * size), xy)
