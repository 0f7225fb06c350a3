"""The inpainted scene as Gaussian splats."""

from typing import Annotated, Literal

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Finite, Positive, RelativePath, Vector3

SplatFormat = Literal["ply", "spz", "glb", "usdc"]


class SplatFidelity(Closed):
    """How far pictures of the splats are from photographs that they were not fitted to; outside the mask."""

    photos: int = Field(description="over how many held-out photographs, each at its own size")
    psnr: Finite = Field(description="dB, mean over the photographs")
    ssim: Finite
    lpips_vgg: Finite = Field(description="over whole pictures, which are equal under the mask")
    field_psnr: Finite | None = Field(default=None, description="dB, the radiance field's own, as its artifact says")


class SplatScene(Closed):
    """The same splats as `splats.ply`, `.spz`, `.glb` and `.usdc`; their colours do not depend on the view."""

    files: dict[SplatFormat, RelativePath] = Field(
        description="by format: 3D Gaussian Splatting's PLY (y down, z forward), SPZ and GLB with "
        "KHR_gaussian_splatting (y up), a USD layer with a ParticleField3DGaussianSplat (z up); scene units"
    )
    splats: Annotated[int, Field(ge=1)]
    fidelity: SplatFidelity | None = Field(default=None, description="None: no photograph was held out")
    bounds_min: Vector3 = Field(description="of the centres, scene units, z up")
    bounds_max: Vector3
    metres_per_unit: Positive | None = Field(default=None, description="of a scene unit; None: unknown")
