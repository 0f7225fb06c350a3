"""A view without its hole, whatever filled it, and how it is written."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import CompletedView, CompletedViews
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.map_io import write_codes, write_exr
from inpaint3d.scene.source_maps import share_sources


@dataclass(frozen=True, eq=False)
class Completion:
    """picture: sRGB-encoded float32 [h, w, 3] in the view's own exposure, the photo's own where it is known.

    sources: uint16 [h, w], where each filled pixel came from (`CompletedView.sources`). depth: z along the axis of
    every cell [h', w'] of the depth map, scene units; None where the method makes no surface. copies: pixel (x, y)
    [h, w, 2] that each was copied from, -1 elsewhere; None where nothing was copied within the view.
    """

    name: str
    picture: NDArray[np.float32]
    sources: NDArray[np.uint16]
    depth: NDArray[np.float32] | None = None
    copies: NDArray[np.float32] | None = None


def write_completions(
    folder: Path, completions: Sequence[Completion], *, method: str, summary: str, reference_views: Sequence[str] = ()
) -> CompletedViews:
    """Write every view's files below `folder`; returns the artifact's metadata."""
    return CompletedViews(
        method=method,
        summary=summary,
        views=tuple(_write_completion(folder, one) for one in completions),
        reference_views=tuple(reference_views),
    )


def _write_completion(folder: Path, one: Completion) -> CompletedView:
    picture, sources = f"pictures/{one.name}.png", f"sources/{one.name}.png"
    depth = None if one.depth is None else f"depth/{one.name}.exr"
    write_png(folder / picture, one.picture)
    write_codes(folder / sources, one.sources)
    if one.depth is not None:
        write_exr(folder / f"depth/{one.name}.exr", {"depth.Z": one.depth})
    copies = None if one.copies is None else f"copies/{one.name}.exr"
    if one.copies is not None:
        write_exr(folder / f"copies/{one.name}.exr", {"copied.X": one.copies[..., 0], "copied.Y": one.copies[..., 1]})
    return CompletedView(
        name=one.name,
        picture=picture,
        sources=sources,
        depth=depth,
        copies=copies,
        shares=share_sources(one.sources),
    )
