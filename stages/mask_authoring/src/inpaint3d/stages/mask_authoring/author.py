"""Each kind of request, turned into a mask for every posed view and every truth camera."""

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts.masks import (
    DifferenceRequest,
    ImportedRequest,
    ObjectRequest,
    ObjectsRequest,
    OutpaintRequest,
    Part,
    ScribbleRequest,
    UnionRequest,
)
from inpaint3d.scene.volumes import volume_mask
from inpaint3d.stages.mask_authoring.authored import Authored
from inpaint3d.stages.mask_authoring.cloud import lift, splat
from inpaint3d.stages.mask_authoring.combine import author_difference, author_objects, author_union
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.finish import finish
from inpaint3d.stages.mask_authoring.hull import carve
from inpaint3d.stages.mask_authoring.objects import author_object
from inpaint3d.stages.mask_authoring.requests import find_view, scribble_path
from inpaint3d.stages.mask_authoring.scene import Scene
from inpaint3d.stages.mask_authoring.scribble import draw, random_path
from inpaint3d.stages.mask_authoring.volumes import VolumeRequest, place

Request = Part | OutpaintRequest | ObjectsRequest


def author(request: Request, scene: Scene, dilate: float, config: Config, ctx: Context) -> Authored:
    """Masks for a request. `dilate` is a share of the shorter side; volumes are exact and not grown."""

    def make(part: Part, dilate: float) -> Authored:
        return author(part, scene, dilate, config, ctx)

    match request:
        case ObjectRequest():
            return author_object(request, scene, dilate, config, ctx)
        case ScribbleRequest():
            return author_scribble(request, scene, dilate, config, ctx)
        case ImportedRequest():
            return author_imported(scene, dilate, config)
        case UnionRequest():
            return author_union(request, make, dilate)
        case DifferenceRequest():
            return author_difference(request, make, dilate)
        case ObjectsRequest():
            return author_objects(request, make, dilate, scene.depth_views)
        case _:
            return author_volume(request, scene)


def author_volume(request: VolumeRequest, scene: Scene) -> Authored:
    """M1, M4: each pixel's ray against the volume."""
    primitive = place(request, scene)
    return Authored(
        origin=request.kind,
        method=f"rays against {'the outside of ' if primitive.inverted else ''}a {primitive.kind}, exact in every view",
        masks=[volume_mask(v.camera, primitive) for v in scene.depth_views],
        truth_masks=[volume_mask(v.camera, primitive) for v in scene.truth],
        primitives=(primitive,),
    )


def author_scribble(request: ScribbleRequest, scene: Scene, dilate: float, config: Config, ctx: Context) -> Authored:
    """M3: a path widened by ellipses on one view, its surface shown in the others."""
    source = find_view(scene.views, request.view)
    view = scene.depth_views[source]
    width, height = view.camera.width, view.camera.height
    path = scribble_path(request, view.camera) if request.path else random_path(width, height, ctx.seed)
    drawn = draw(path, width, height, request.thickness * min(width, height), ctx.seed)
    surface = lift(view, drawn)
    if not len(surface):
        raise BadInputError(
            f"the field has no surface under the scribble in view {request.view!r}; draw it elsewhere, or train the "
            "field longer (nerf-pretraining)"
        )
    shown = [splat(v, surface, config.depth_tolerance) for v in (*scene.depth_views, *scene.truth)]
    shown[source] |= drawn
    finished = [finish(m, dilate) for m in shown]
    count = len(scene.depth_views)
    drawn_by = "hand" if request.path else "chance"
    return Authored(
        origin="scribble",
        method=f"path drawn by {drawn_by} in {request.view}, widened by ellipses, reprojected with field depth",
        masks=finished[:count],
        truth_masks=finished[count:],
    )


def author_imported(scene: Scene, dilate: float, config: Config) -> Authored:
    """M5: the capture's own masks; views without one get what the others outline in space."""
    given = [v.mask() for v in scene.views]
    known = [(v, m) for v, m in zip(scene.depth_views, given, strict=True) if m is not None]
    if not known:
        raise ConfigurationError(
            "mask request: `imported` asks for the capture's own masks, but none of its views has one; put them in "
            "masks/ beside images/, with the same stems, or describe the mask in another way"
        )
    masks, truth_masks, carried = given, [], ""
    if scene.truth or len(known) < len(given):
        views, own = [v for v, _ in known], [m for _, m in known]
        hull = carve(views, own, voxels=config.voxels, agreement=config.agreement, tolerance=config.depth_tolerance)
        shown = [splat(v, hull, config.depth_tolerance) for v in scene.depth_views]
        masks = [s if m is None else m for m, s in zip(given, shown, strict=True)]
        truth_masks = [splat(v, hull, config.depth_tolerance) for v in scene.truth]
        carried = f"; {len(given) - len(known)} views without one from a voxel hull"
    return Authored(
        origin="imported",
        method=f"masks of the capture for {len(known)} of {len(given)} views{carried}",
        masks=[finish(m, dilate) for m in masks if m is not None],
        truth_masks=[finish(m, dilate) for m in truth_masks],
    )
