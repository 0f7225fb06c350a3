"""Pictures as another exposure would have them: through the appearance codes of a field (row N6)."""

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.radiance.backends.reference import COLOUR_PADDING
from inpaint3d.radiance.fields import RadianceField

Image = NDArray[np.float32]
DARKEST = 1e-3
"""Codes act on logits, which black and white do not have."""


class AppearanceMap:
    """Between the appearance of a training view and the mean of all, which renders for the hole have.

    field: with a code for each training view; without one, or without codes, pictures stay as they are.
    """

    def __init__(self, field: RadianceField | None) -> None:
        self._codes: tuple[torch.Tensor, torch.Tensor] | None = None
        if field is not None and field.spec.glo:
            with torch.no_grad():
                views = torch.arange(field.spec.glo_views, device=field.device)
                each, mean = field.appearance(views, "view"), field.appearance(None, "mean")
            if each is not None and mean is not None:
                self._codes = each.cpu(), mean[0].cpu()

    def to_mean(self, image: Image, view: int) -> Image:
        """The picture of a view as the mean code would show it."""
        return image if self._codes is None else _convert(image, self._codes[0][view], self._codes[1])

    def from_mean(self, image: Image, view: int) -> Image:
        """The other way round."""
        return image if self._codes is None else _convert(image, self._codes[1], self._codes[0][view])


def _convert(image: Image, own: torch.Tensor, wanted: torch.Tensor) -> Image:
    """From one log gain and offset of the logits to another, each [6]."""
    share = (torch.from_numpy(image) + COLOUR_PADDING) / (1 + 2 * COLOUR_PADDING)
    logits = torch.logit(share.clamp(DARKEST, 1 - DARKEST))
    plain = (logits - own[3:]) / own[:3].exp()
    shown = torch.sigmoid(plain * wanted[:3].exp() + wanted[3:])
    return (shown * (1 + 2 * COLOUR_PADDING) - COLOUR_PADDING).clamp(0, 1).numpy()
