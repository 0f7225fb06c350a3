"""The files of a radiance-field artifact. Importing this takes no torch: stubs write through the same functions."""

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.contracts.models.artifacts import FieldSpec, FieldView
from inpaint3d.radiance.architecture import parameter_shapes
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.map_io import write_exr
from inpaint3d.scene.normals import normals_of

if TYPE_CHECKING:
    from inpaint3d.radiance.fields import RadianceField

# Less opaque than this, most light goes through: there is no surface that could have a normal.
OPAQUE = 0.5
CURVE_COLUMNS = ("step", "rays", "loss", "psnr")


def write_views(
    folder: Path,
    field: "RadianceField",
    views: Sequence[tuple[str, Camera]],
    *,
    longest_side: int,
    block: int = 4096,
    tick: Callable[[int, int], None] | None = None,
) -> tuple[FieldView, ...]:
    """Render every (name, camera) at `longest_side` pixels or its own size if smaller, mean appearance code."""
    from inpaint3d.radiance.rendering import render_view

    written = []
    for index, (name, camera) in enumerate(views):
        if tick is not None:
            tick(index, len(views))
        small = reduce_camera(camera, longest_side)
        written.append(write_view(folder, name, small, render_view(field, small, block=block)))
    return tuple(written)


def write_view(folder: Path, name: str, camera: Camera, maps: Mapping[str, NDArray[np.floating]]) -> FieldView:
    """Write what `render_view` returns of a camera: its maps in views/NAME.exr, its colour in views/NAME.png.

    Normals are those of the median depth. NonFiniteError where a map is not finite.
    """
    for channel, values in maps.items():
        if len(places := np.argwhere(~np.isfinite(values))):
            raise NonFiniteError(
                f"the render of view {name} is not finite: {channel} in {len(places)} numbers, "
                f"the first at row {places[0][0]}, column {places[0][1]}"
            )
    view = FieldView(name=name, maps=f"views/{name}.exr", picture=f"views/{name}.png")
    seen = np.where(maps["opacity"] > OPAQUE, maps["median_depth"], np.nan)
    x, y, z = np.moveaxis(normals_of(camera, seen), -1, 0)
    write_exr(
        folder / view.maps,
        {
            "depth.Z": maps["depth"], "median.Z": maps["median_depth"], "opacity.A": maps["opacity"],
            "normal.X": x, "normal.Y": y, "normal.Z": z,
        },
    )  # fmt: skip
    write_png(folder / view.picture, maps["rgb"])
    return view


def reduce_camera(camera: Camera, longest_side: int) -> Camera:
    """The camera with its longest side reduced to at most `longest_side` pixels; never enlarged."""
    share = min(1.0, longest_side / max(camera.width, camera.height))
    return camera.resize_to(max(1, round(camera.width * share)), max(1, round(camera.height * share)))


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Sequence[float | int]]) -> None:
    """A CSV of numbers with seven significant digits; NaN becomes an empty cell."""
    with path.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(columns)
        table.writerows([["" if math.isnan(v) else f"{v:.7g}" for v in row] for row in rows])


def write_curve(folder: Path, rows: Sequence[Sequence[float | int]]) -> None:
    """learning_curve.csv: step, rays so far, loss, held-out PSNR (dB; NaN where none was rendered)."""
    write_table(folder / "learning_curve.csv", CURVE_COLUMNS, rows)


def stub_weights(spec: FieldSpec, seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """Small random weights that `load_field` takes for a spec."""
    rng = np.random.default_rng(seed)
    shapes = sorted(parameter_shapes(spec).items())
    return {name: rng.uniform(-0.1, 0.1, shape).astype(np.float32) for name, shape in shapes}
