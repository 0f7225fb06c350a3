"""What a run is judged by, and what a production takes away."""

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Finite, Positive, RelativePath, Share, Vector3


class Metric(Closed):
    """One figure of one method under one protocol."""

    method: str = Field(description="label of the radiance field, or the name of an image baseline")
    name: str = Field(description="psnr, ssim, lpips_vgg, lpips_alex, fd_lite0, kid_lite0, ...")
    value: Finite
    unit: str = Field(description="'dB', '1'")
    better: str = Field(description="'higher' or 'lower'")
    views: int = Field(description="over how many views")


class Protocol(Closed):
    """What was measured on what, in words, and the figures."""

    name: str = Field(description="e.g. 'hole-box-vs-truth', 'held-out-known-pixels'")
    description: str
    metrics: tuple[Metric, ...]


class Evaluation(Closed):
    """Figures by protocol; `per_view.csv`, `pictures/`, and a self-contained `report.html`.

    The report has a line `<!-- inpaint3d:doubts -->` and a line `<!-- inpaint3d:run -->` where the orchestrator puts
    why the run's results cannot be right, and its times, which are not part of the artifact.
    """

    protocols: tuple[Protocol, ...]
    per_view: RelativePath = "per_view.csv"
    report: RelativePath = "report.html"
    pictures: tuple[RelativePath, ...] = ()
    non_finite: dict[str, int] = {}


class MeshFidelity(Closed):
    """How far renders of the textured mesh are from photographs that it was not made of; outside the mask."""

    photos: int = Field(description="over how many held-out photographs, each at its own size")
    psnr: Finite = Field(description="dB, mean over the photographs")
    ssim: Finite
    field_psnr: Finite | None = Field(default=None, description="dB, the radiance field's own, as its artifact says")


class UsdScene(Closed):
    """`scene.usdz` (mesh, textures, cameras, masks) and `scene.usdc` with `textures/` beside it."""

    package: RelativePath = "scene.usdz"
    layer: RelativePath = "scene.usdc"
    textures: tuple[RelativePath, ...] = ()
    models: tuple[RelativePath, ...] = Field(default=(), description="each variant's mesh as GLB, its texture inside")
    point_clouds: tuple[RelativePath, ...] = Field(default=(), description="each variant as PLY: x, y, z, normal, sRGB")
    triangles: int
    charts: int = Field(description="pieces that the mesh was cut into to be flattened")
    texel_use: Share = Field(description="of the texture, what lies in a chart")
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
