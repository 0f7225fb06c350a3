"""A baseline: every view inpainted on its own, from its own known pixels."""

from collections.abc import Sequence

import numpy as np

from inpaint3d.contracts.models.artifacts.completion import SOURCE_CODES
from inpaint3d.diffusion.fill import fill_telea
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.stages.view_completion.completion import Completion


def complete_classically(views: Sequence[MaskedView]) -> list[Completion]:
    """The views with their holes filled by Telea's method (2004)."""
    return [
        Completion(
            view.name,
            np.where(view.hole[..., None], fill_telea(view.image, ~view.known), view.image),
            np.where(view.hole, SOURCE_CODES["smooth"], 0).astype(np.uint16),
        )
        for view in views
    ]
