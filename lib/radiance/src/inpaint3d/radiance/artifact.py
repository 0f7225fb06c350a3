"""The files of a radiance-field artifact. Importing this takes no torch: stubs write through the same functions."""

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.artifacts import FieldSpec, FieldView, GridSpec
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import write_exr, write_png

if TYPE_CHECKING:
    from inpaint3d.radiance.fields import RadianceField

CURVE_COLUMNS = ("step", "rays", "loss", "psnr")


def write_views(
    folder: Path,
    field: "RadianceField",
    views: Sequence[tuple[str, Camera]],
    *,
    longest_side: int,
    block: int = 4096,
    tick: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[FieldView, ...]:
    """Render every (name, camera) at `longest_side` pixels or its own size if smaller, mean appearance code."""
    from inpaint3d.radiance.rendering import render_view

    written = []
    for index, (name, camera) in enumerate(views):
        tick(index, len(views))
        written.append(write_view(folder, name, render_view(field, reduced(camera, longest_side), block=block)))
    return tuple(written)


def write_view(folder: Path, name: str, maps: Mapping[str, NDArray[np.floating]]) -> FieldView:
    """Write the maps that `render_view` returns: views/NAME.exr (depth.Z, median.Z, opacity.A) and views/NAME.png."""
    view = FieldView(name=name, maps=f"views/{name}.exr", picture=f"views/{name}.png")
    write_exr(
        folder / view.maps,
        {"depth.Z": maps["depth"], "median.Z": maps["median_depth"], "opacity.A": maps["opacity"]},
    )
    write_png(folder / view.picture, maps["rgb"])
    return view


def reduced(camera: Camera, longest_side: int) -> Camera:
    """The camera with its longest side reduced to at most `longest_side` pixels; never enlarged."""
    share = min(1.0, longest_side / max(camera.width, camera.height))
    return camera.scaled(max(1, round(camera.width * share)), max(1, round(camera.height * share)))


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
    """A CSV of numbers with seven significant digits; NaN becomes an empty cell."""
    with path.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(columns)
        table.writerows([["" if math.isnan(v) else f"{v:.7g}" for v in row] for row in rows])


def write_curve(folder: Path, rows: Sequence[Sequence[float]]) -> None:
    """learning_curve.csv: step, rays so far, loss, held-out PSNR (dB; NaN where none was rendered)."""
    write_table(folder / "learning_curve.csv", CURVE_COLUMNS, rows)


def stub_weights(spec: FieldSpec, seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """Weights that `load_field` takes for a spec: the names and shapes of RadianceField's state, small random numbers."""
    rng = np.random.default_rng(seed)
    glo = {"codes": (max(spec.glo_views, 1), spec.glo), "code_map": (spec.glo, 6)} if spec.glo else {}
    heads = 4 + (spec.bottleneck if spec.view_layers else 0)
    shapes: dict[str, tuple[int, ...]] = {
        **_network("proposal", spec.proposal_grid, [spec.density_width, 1]),
        **_network("base", spec.grid, [spec.density_width, heads]),
        **glo,
    }
    if spec.view_layers:
        # 16: spherical harmonics of the direction up to the fourth band.
        widths = [spec.bottleneck + 16, *[spec.view_width] * spec.view_layers, 3]
        shapes |= {f"specular.{i}": (widths[i + 1], widths[i]) for i in range(len(widths) - 1)}
    return {name: rng.uniform(-0.1, 0.1, shape).astype(np.float32) for name, shape in sorted(shapes.items())}


def _network(name: str, grid: GridSpec, widths: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Shapes of a hash grid's table and of the network on it."""
    growth = (grid.finest / grid.coarsest) ** (1 / max(grid.levels - 1, 1))
    vertices = [(round(grid.coarsest * growth**i) + 1) ** 3 for i in range(grid.levels)]
    entries = sum(min(v, 2**grid.log2_table) for v in vertices)
    sizes = [grid.levels * grid.channels, *widths]
    layers = {f"{name}.weights.{i}": (sizes[i + 1], sizes[i]) for i in range(len(widths))}
    return {f"{name}.table": (entries, grid.channels), **layers}
