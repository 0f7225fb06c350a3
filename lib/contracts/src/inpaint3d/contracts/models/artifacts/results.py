"""What a run is judged by, and what a production takes away."""

from typing import Annotated

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Finite, Positive, RelativePath, Share, Vector3


class Metric(Closed):
    """One figure of one method under one protocol: a mean over views, or a figure of the whole set of them."""

    method: str = Field(description="label of the radiance field, or the name of an image baseline")
    name: str = Field(description="psnr, ssim, lpips_vgg, lpips_alex, fd_lite0, kid_lite0, ...")
    title: str = Field(default="", description="what a page calls the figure; empty: its name")
    value: Finite
    digits: int = Field(default=3, description="decimals that a page shows")
    unit: str = Field(description="'dB', '1'")
    better: str = Field(description="'higher' or 'lower'")
    views: int = Field(description="over how many views")
    low: Finite | None = Field(default=None, description="lower end of the 95 % bootstrap interval over the views")
    high: Finite | None = Field(default=None, description="its upper end")
    standard_error: Finite | None = Field(default=None, description="of a figure of the whole set, by the jackknife")
    equal_views: Annotated[int, Field(ge=0)] = Field(
        default=0, description="views that equal the truth: their PSNR is infinite and not in the mean"
    )


class Protocol(Closed):
    """What was measured on what, in words, and the figures. Figures of other names or versions are not comparable."""

    name: str = Field(description="e.g. 'bbox10-vgg', 'held-out-known-pixels'")
    version: Annotated[int, Field(ge=1)] = Field(default=1, description="raised when a figure's meaning changes")
    description: str
    crop: str = Field(default="", description="which pixels are compared")
    resolution: str = Field(default="", description="the size that they are compared at")
    colour_range: str = Field(default="", description="of the colours that are compared")
    networks: tuple[str, ...] = Field(default=(), description="with their weights, of the figures that need one")
    views: Annotated[int, Field(ge=0)] | None = Field(default=None, description="how many were scored")
    metrics: tuple[Metric, ...]


class PictureStrip(Closed):
    """Panels of one size side by side in one PNG, with `gap` pixels of white between them."""

    view: str = Field(description="what of the capture they show")
    file: RelativePath = Field(description="pictures/NAME.png")
    captions: tuple[str, ...] = Field(min_length=1, description="one for each panel, from the left")
    gap: int = 0


class Evaluation(Closed):
    """Figures by protocol with what to know of them; `per_view.csv` and `pictures/`."""

    protocols: tuple[Protocol, ...]
    per_view: RelativePath = "per_view.csv"
    pictures: tuple[RelativePath, ...] = ()
    contact: PictureStrip | None = Field(
        default=None, description="before, mask, after and depth in the view that shows the hole best"
    )
    strips: tuple[PictureStrip, ...] = Field(default=(), description="other views, panels side by side")
    weaknesses: tuple[str, ...] = Field(default=(), description="what came out weak, or could not be told, in words")
    limits: tuple[str, ...] = Field(default=(), description="how far figures like these can be trusted")
    non_finite: dict[str, int] = {}


class MeshFidelity(Closed):
    """How far renders of the textured mesh are from photographs that it was not made of; outside the mask."""

    photos: int = Field(description="over how many held-out photographs, each at its own size")
    psnr: Finite = Field(description="dB, mean over the photographs")
    ssim: Finite
    field_psnr: Finite | None = Field(default=None, description="dB, the radiance field's own, as its artifact says")


class UsdScene(Closed):
    """`scene.usdz` (mesh, textures, cameras, masks) and `scene.usdc` with its payloads and `textures/` beside it."""

    package: RelativePath = "scene.usdz"
    layer: RelativePath = "scene.usdc"
    payloads: tuple[RelativePath, ...] = Field(default=(), description="each variant's layer, which `layer` loads")
    textures: tuple[RelativePath, ...] = ()
    models: tuple[RelativePath, ...] = Field(default=(), description="each variant's mesh as GLB, its texture inside")
    point_clouds: tuple[RelativePath, ...] = Field(default=(), description="each variant as PLY: x, y, z, normal, sRGB")
    triangles: int
    charts: int = Field(description="pieces that the mesh was cut into to be flattened")
    texel_use: Share = Field(description="of the texture, what lies in a chart")
    collision_pieces: int = Field(default=0, description="convex pieces that bodies collide with")
    fidelity: MeshFidelity | None = Field(default=None, description="None: no photograph was held out")
    cameras: int
    variants: tuple[str, ...] = Field(default=(), description="e.g. 'inpainted', 'original', 'mask'")
    bounds_min: Vector3
    bounds_max: Vector3
    metres_per_unit: Positive | None = Field(
        default=None,
        description="of a scene unit; None: unknown, and the layer's metersPerUnit of 1 means nothing",
    )
    validation: RelativePath = "validation.json"
    validation_errors: int
