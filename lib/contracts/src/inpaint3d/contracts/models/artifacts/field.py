"""A radiance field: its architecture, weights, per-view renders and learning curve."""

from typing import Annotated, Literal

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Finite, FrameName, Positive, RelativePath

Count = Annotated[int, Field(ge=1)]


class GridSpec(Closed):
    """A multiresolution hash grid (Instant-NGP, arXiv:2201.05989); dense where (res + 1)^3 fits the table (N3)."""

    levels: Count = 10
    coarsest: Count = Field(default=16, description="cells per side at the coarsest level")
    finest: Count = Field(default=8192, description="cells per side at the finest level")
    log2_table: Annotated[int, Field(ge=4, le=28)] = 21
    channels: Count = 4


class FieldSpec(Closed):
    """The architecture of a field (conformance N1 to N6); the defaults are the paper's."""

    sampler: Literal["proposal", "density-grid"] = Field(
        default="proposal",
        description="where rays ask the field: where a smaller network proposes (N2), or where its density, kept in "
        "cells, was found",
    )
    proposal_grid: GridSpec = Field(default=GridSpec(channels=1), description="proposal only")
    proposal_samples: tuple[Count, ...] = Field(default=(64, 64), description="proposal only: of each round")
    density_cells: Count = Field(default=96, description="density-grid only: cells per side")
    density_bins: Count = Field(default=64, description="density-grid only: intervals of a ray that are looked up")
    grid: GridSpec = GridSpec()
    samples: Count = 32
    density_width: Count = 64
    bottleneck: Annotated[int, Field(ge=0)] = 15
    view_width: Count = 64
    view_layers: Annotated[int, Field(ge=0, description="0: no view-dependent colour")] = 2
    contraction: bool = Field(default=True, description="Mip-NeRF 360 contraction outside the unit ball")
    bound: Positive = Field(default=1.0, description="without contraction: half side of the cube that holds the scene")
    glo: Annotated[int, Field(ge=0, description="length of the per-view appearance code; 0: none")] = 0
    glo_views: Annotated[int, Field(ge=0)] = 0
    near: Positive = 0.05
    far: Positive = 1000.0


class FieldView(Closed):
    """Renders of one training or test view, all at one size."""

    name: FrameName
    maps: RelativePath = Field(
        description="views/NAME.exr: depth.Z (along the axis), median.Z, opacity.A, and since 1.1 the normal.X, .Y, .Z "
        "of the median depth (world axes, towards the camera; 0 where opacity is under a half); float32; scene units"
    )
    picture: RelativePath = Field(description="views/NAME.png: the rendered colour, mean code")


class RadianceFieldArtifact(Closed):
    """Weights (`weights.safetensors`), architecture, per-view renders, learning curve.

    `learning_curve.csv`: step, rays, loss, psnr (held-out views, dB; empty where none was rendered).
    Wall and CPU times of the same steps are in the sidecar of the run, since equal results must have equal digests.
    """

    label: str = Field(description="what this field is: 'pretrained', 'joint-sds', 'masked-reconstruction', ...")
    spec: FieldSpec
    weights: RelativePath = "weights.safetensors"
    learning_curve: RelativePath = "learning_curve.csv"
    views: tuple[FieldView, ...]
    steps: int
    seed: int
    backend: str
    held_out_psnr: Finite | None = Field(default=None, description="dB, mean over test views (known pixels)")
    depth_error: Finite | None = Field(
        default=None, description="median relative error of the depth at the sparse points, as the cameras saw them"
    )
    floaters: Finite | None = Field(
        default=None, description="mean opacity in front of nine tenths of the way to those points"
    )
    decisions: dict[str, str] = Field(
        default={}, description="effects decided here (those that need the mask), with reasons"
    )
    non_finite: dict[str, int] = Field(default={}, description="non-finite values met, by place; empty = none")
    health: dict[str, Finite] = Field(
        default={},
        description="counters of the fit: gradient_norm_largest and _last, density_at_ceiling and colour_saturated "
        "(largest shares of samples), rollbacks to the last checkpoint",
    )
