"""The parts of the export that need no network: views to a textured mesh, meshes to a validated scene."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import MeshFidelity, Primitive, UsdScene
from inpaint3d.radiance.surface_views import SurfaceView
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import SparsePoints
from inpaint3d.scene.image_io import Image, Mask, write_png
from inpaint3d.stages.usd_export.atlas import Texels, find_texels, unwrap
from inpaint3d.stages.usd_export.collision import split_convex
from inpaint3d.stages.usd_export.config import Config
from inpaint3d.stages.usd_export.contraction import contract
from inpaint3d.stages.usd_export.fidelity import HeldOutPhoto, measure_fidelity
from inpaint3d.stages.usd_export.fusion import Box
from inpaint3d.stages.usd_export.gltf import write_glb, write_point_cloud
from inpaint3d.stages.usd_export.guides import visual_hull
from inpaint3d.stages.usd_export.layer import Content, Scene, name_payload, write_layers
from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.package import write_package
from inpaint3d.stages.usd_export.rays import Caster
from inpaint3d.stages.usd_export.soundness import refuse_broken
from inpaint3d.stages.usd_export.surface import make_surface
from inpaint3d.stages.usd_export.texture import Picture, even_exposures, fill_texture, look, measure_filled, paint
from inpaint3d.stages.usd_export.validation import as_document, validate

LAYER, PACKAGE, VALIDATION = "scene.usdc", "scene.usdz", "validation.json"
HULL_GRID = 64
POINTS = 200_000  # of a point cloud, at most: as dense where the texture is dense


@dataclass(frozen=True, eq=False)
class MaskVolume:
    """What the mask's guide is made of: primitives, or masks with their cameras."""

    primitives: Sequence[Primitive]
    cameras: Sequence[Camera]
    masks: Sequence[Mask]


@dataclass(frozen=True, eq=False)
class Capture:
    """What of the capture goes into the scene as it is."""

    names: Sequence[str]
    cameras: Sequence[Camera]
    points: SparsePoints | None
    metres_per_unit: float | None
    provenance: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Textured:
    """A content with its texture [size, size, 3] and what the atlas came to."""

    content: Content
    texture: Image
    charts: int
    texel_use: float

    def measure(self, photos: Sequence[HeldOutPhoto], field_psnr: float | None) -> MeshFidelity | None:
        """How far the textured mesh is from photos that it was not made of; None without any."""
        mesh = self.content.mesh
        found = measure_fidelity(Caster(mesh.vertices, mesh.triangles), self.content.coordinates, self.texture, photos)
        if found is None:
            return None
        psnr, ssim = (round(score, 4) for score in found)
        return MeshFidelity(photos=len(photos), psnr=psnr, ssim=ssim, field_psnr=field_psnr)


def make_content(
    name: str, views: Sequence[SurfaceView], pictures: Sequence[Picture], box: Box, folder: Path, config: Config
) -> Textured:
    """Fuse, unwrap and paint one content; its texture, GLB and point cloud are written.

    Raises BadInputError without a surface. What no picture shows takes its colours from the views.
    """
    mesh = make_surface(
        views,
        box,
        grid=config.grid,
        truncation_cells=config.truncation_cells,
        smallest_piece=config.smallest_piece,
        triangles=config.triangles,
    )
    if len(mesh.triangles) == 0:
        raise BadInputError(
            f"the depth of '{name}' fuses to no surface at all in a grid of {config.grid}; the field is "
            "fog: train it longer"
        )
    size = config.texture_size
    # In contracted space what is far away is small: so it is in the photos.
    atlas = unwrap(Mesh(contract(mesh.vertices), mesh.triangles), size)
    texels = find_texels(atlas, size)
    colour, known, filled = _paint(mesh, texels, views, pictures)
    texture = fill_texture(texels, colour, known, size)
    path = f"textures/{name}.png"
    write_png(folder / path, texture)
    write_glb(folder / f"{name}.glb", mesh, atlas.coordinates, folder / path)
    few = slice(None, None, -(-len(texels.row) // POINTS))
    points = np.einsum("nc,ncd->nd", texels.barycentric[few], mesh.corners()[texels.triangle[few]])
    painted = texture[texels.row[few], texels.column[few]]
    write_point_cloud(folder / f"{name}.ply", points, mesh.normals()[texels.triangle[few]], painted)
    content = Content(name, mesh, atlas.coordinates, path, filled, split_convex(mesh, config.collision_pieces))
    return Textured(content, texture, atlas.charts, len(texels.row) / size**2)


def write_scene(
    folder: Path,
    made: Sequence[Textured],
    capture: Capture,
    mask: MaskVolume,
    fidelity: MeshFidelity | None = None,
) -> UsdScene:
    """Write the layer, the package and the validators' findings; returns the artifact's metadata.

    Raises StageError where what was written is broken.
    """
    contents = [one.content for one in made]
    every = np.concatenate([content.mesh.vertices for content in contents])
    low, high = every.min(0), every.max(0)
    hull = _make_hull(mask)
    write_layers(
        folder / LAYER,
        Scene(
            contents,
            capture.names,
            capture.cameras,
            mask.primitives,
            hull,
            capture.points,
            capture.metres_per_unit,
            capture.provenance,
        ),
    )
    payloads = [name_payload(content) for content in contents]
    packed = [LAYER, *payloads, *(content.texture for content in contents)]
    write_package(folder / PACKAGE, [(name, folder / name) for name in packed])
    refuse_broken(folder, [LAYER, PACKAGE])
    findings = validate(folder, [LAYER, PACKAGE])
    (folder / VALIDATION).write_text(json.dumps(as_document(findings), indent=1, sort_keys=True) + "\n")
    return UsdScene(
        payloads=tuple(payloads),
        textures=tuple(content.texture for content in contents),
        models=tuple(f"{content.name}.glb" for content in contents),
        point_clouds=tuple(f"{content.name}.ply" for content in contents),
        triangles=len(contents[0].mesh.triangles),
        charts=made[0].charts,
        texel_use=round(made[0].texel_use, 4),
        collision_pieces=len(contents[0].pieces),
        fidelity=fidelity,
        cameras=len(capture.cameras),
        variants=tuple(content.name for content in contents),
        bounds_min=_to_vector(low),
        bounds_max=_to_vector(high),
        metres_per_unit=capture.metres_per_unit,
        validation_errors=sum(f.severity == "Error" for f in findings),
    )


def _paint(
    mesh: Mesh, texels: Texels, views: Sequence[SurfaceView], pictures: Sequence[Picture]
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.float32]]:
    """Colours of the texels [n, 3], which of them are known [n], and how much of each triangle was filled [t]."""
    caster = Caster(mesh.vertices, mesh.triangles)
    sights = even_exposures(mesh, texels, [look(mesh, caster, picture) for picture in pictures])
    colour, known = paint(mesh, texels, sights)
    if not known.all():
        rest = Texels(texels.row[~known], texels.column[~known], texels.triangle[~known], texels.barycentric[~known])
        rendered = [look(mesh, caster, Picture(v.camera, v.rgb, v.depth > 0)) for v in views]
        colour[~known], known[~known] = paint(mesh, rest, rendered)
    return colour, known, measure_filled(sights)


def _to_vector(corner: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(corner[0]), float(corner[1]), float(corner[2])


def _make_hull(mask: MaskVolume) -> Mesh | None:
    """The hull of the mask in the unit ball, where the cameras and the point of interest are, and a bit around it."""
    if not mask.masks:
        return None
    reach = np.full(3, 1.5)
    hull = visual_hull(mask.cameras, mask.masks, -reach, reach, HULL_GRID)
    return hull if len(hull.triangles) else None
