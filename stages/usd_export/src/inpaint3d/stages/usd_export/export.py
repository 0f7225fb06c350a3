"""The parts of the export that need no network: views to a textured mesh, meshes to a validated scene."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import Primitive, UsdScene
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Mask, write_png
from inpaint3d.stages.usd_export import atlas
from inpaint3d.stages.usd_export.config import Config
from inpaint3d.stages.usd_export.fusion import corners, fuse
from inpaint3d.stages.usd_export.guides import visual_hull
from inpaint3d.stages.usd_export.layer import Content, Scene, write_layer
from inpaint3d.stages.usd_export.mesh import Mesh, compact, extract, remove_floaters
from inpaint3d.stages.usd_export.package import write_package
from inpaint3d.stages.usd_export.surface_views import SurfaceView
from inpaint3d.stages.usd_export.validation import as_document, validate

LAYER, PACKAGE, VALIDATION = "scene.usdc", "scene.usdz", "validation.json"
HULL_GRID = 64

Box = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class MaskVolume:
    """What the mask's guide is made of: primitives, or masks with their cameras."""

    primitives: Sequence[Primitive]
    cameras: Sequence[Camera]
    masks: Sequence[Mask]


def make_content(name: str, views: Sequence[SurfaceView], box: Box, folder: Path, config: Config) -> Content:
    """Fuse, extract, lay out and bake one content; its texture is written. Raises BadInputError without a surface."""
    cell, _ = corners(*box, config.grid)
    volume = fuse(views, *box, grid=config.grid, truncation_cells=config.truncation_cells)
    mesh = remove_floaters(extract(volume), config.smallest_piece)
    if len(mesh.triangles) == 0:
        raise BadInputError(
            f"the depth of '{name}' fuses to no surface at all in a grid of {config.grid}; the field is "
            "fog: train it longer"
        )
    chosen, weight = atlas.best_views(mesh, views, config.texture_views, config.truncation_cells * cell)
    # Triangles that no view shows have no colour to give them; most are the ragged border of the surface.
    shown = weight[:, 0] > 0
    mesh = compact(mesh.vertices, mesh.triangles[shown])
    plan = atlas.layout(len(mesh.triangles), config.texture_size)
    texture = atlas.bake(mesh, views, plan, chosen[shown], weight[shown])
    path = f"textures/{name}.png"
    write_png(folder / path, texture)
    return Content(name, mesh, atlas.coordinates(plan, len(mesh.triangles)), path)


def write_scene(
    folder: Path,
    contents: Sequence[Content],
    names: Sequence[str],
    cameras: Sequence[Camera],
    mask: MaskVolume,
    metres_per_unit: float | None,
) -> UsdScene:
    """Write the layer, the package and the validators' findings; returns the artifact's metadata."""
    every = np.concatenate([content.mesh.vertices for content in contents])
    low, high = every.min(0), every.max(0)
    hull = _make_hull(mask, low, high)
    scene = Scene(contents, names, cameras, mask.primitives, hull, metres_per_unit)
    write_layer(folder / LAYER, scene)
    write_package(folder / PACKAGE, [(LAYER, folder / LAYER), *((c.texture, folder / c.texture) for c in contents)])
    findings = validate(folder, [LAYER, PACKAGE])
    (folder / VALIDATION).write_text(json.dumps(as_document(findings), indent=1, sort_keys=True) + "\n")
    return UsdScene(
        textures=tuple(content.texture for content in contents),
        triangles=len(contents[0].mesh.triangles),
        cameras=len(cameras),
        variants=tuple(content.name for content in contents),
        bounds_min=_to_vector(low),
        bounds_max=_to_vector(high),
        metres_per_unit=metres_per_unit,
        validation_errors=sum(f.severity == "Error" for f in findings),
    )


def _to_vector(corner: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(corner[0]), float(corner[1]), float(corner[2])


def _make_hull(mask: MaskVolume, low: NDArray[np.float64], high: NDArray[np.float64]) -> Mesh | None:
    if not mask.masks:
        return None
    hull = visual_hull(mask.cameras, mask.masks, low, high, HULL_GRID)
    return hull if len(hull.triangles) else None
