"""Source maps: where each filled pixel of a view came from, as `completed-views` codes it."""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO, SOURCE_CODES, Origin


def share_sources(sources: NDArray[np.uint16]) -> dict[Origin, float]:
    """By source, its share of the filled pixels of a map [h, w]; sources that it does not hold are left out."""
    filled = sources[sources > 0]
    counts: dict[Origin, int] = {"photos": int((filled >= FIRST_PHOTO).sum())}
    counts |= {name: int((filled == code).sum()) for name, code in SOURCE_CODES.items()}
    return {name: round(count / len(filled), 6) for name, count in counts.items() if count}
