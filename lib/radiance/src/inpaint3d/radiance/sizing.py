"""How large a field is: the parameters that size it, and the field that they and an effect plan make."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from inpaint3d.contracts.models.artifacts import EffectPlan, FieldSpec, GridSpec
from inpaint3d.contracts.models.base import Closed, Positive, Share
from inpaint3d.radiance.architecture import planned_spec

Count = Annotated[int, Field(ge=1)]
Samples = Annotated[int, Field(ge=2)]
Log2 = Annotated[int, Field(ge=4, le=28)]

# Without contraction the cube is just large enough for this percentage of the sparse points (outliers would make it far
# too large), times the margin.
POINTS_INSIDE, CUBE_MARGIN = 99.0, 1.1
# Scene analysis calls a scene bounded that has up to 2 % of its points far away. Where these reach this many times as
# far as all but 3 %, the cube leaves them out.
CORE_INSIDE, FAR_BEYOND = 97.0, 2.0


class Architecture(Closed):
    """Size of a field. What the effect plan switches off is left out."""

    levels: Count = Field(default=8, description="resolutions of the hash grid; 10 in the paper (N3)")
    coarsest: Count = Field(default=16, description="cells per side at the coarsest level (N3)")
    finest: Count = Field(default=1024, description="cells per side at the finest level; 8192 in the paper (N3)")
    log2_table: Log2 = Field(default=17, description="log2 of the entries of a level; 21 in the paper (N3)")
    channels: Count = Field(default=4, description="numbers per entry; 4 in the paper (N3)")
    samples: Samples = Field(default=24, description="field samples a ray; 32 in the paper (N2)")
    sampler: Literal["proposal", "density-grid"] = Field(
        default="proposal",
        description="where rays ask the field: where a smaller network proposes (N2), or where it was "
        "dense when last asked",
    )
    density_cells: Count = Field(default=96, description="cells per side of the density grid")
    density_bins: Samples = Field(default=64, description="intervals of a ray that are looked up in it")
    proposal_samples: tuple[Samples, ...] = Field(
        default=(48,), description="samples a ray of each proposal round; 64, 64 in the paper (N2)"
    )
    proposal_levels: Count = Field(default=5, description="resolutions of the proposal's grid; 10 in the paper (N3)")
    proposal_finest: Count = Field(default=256, description="cells per side of its finest level; 8192 in the paper")
    proposal_log2_table: Log2 = Field(default=16, description="log2 of the entries of its levels; 21 in the paper")
    density_width: Count = Field(default=64, description="width of the density networks (N4)")
    bottleneck: Count = Field(default=15, description="numbers that reach the view-dependent network (N4)")
    view_width: Count = Field(default=64, description="width of the view-dependent network (N4)")
    view_layers: Count = Field(default=2, description="its hidden layers, where the plan has view dependence on (N4)")
    glo: Count = Field(default=4, description="length of the appearance codes, where the plan has exposure on (N6)")
    near_share: Share = Field(default=0.1, description="where rays start, as a share of the capture's centre depth")
    far: Positive = Field(default=1000.0, description="where rays end in an unbounded scene, scene units")


def field_spec(
    size: Architecture, plan: EffectPlan, *, views: int, centre_depth: float, points: NDArray[np.float32]
) -> FieldSpec:
    """The field that the parameters size and the effect plan shapes.

    views: training views. centre_depth: of the posed capture. points [p, 3]: sparse points; where contraction is off
    they say how large the cube is that holds the scene.
    """
    largest = FieldSpec(
        sampler=size.sampler,
        density_cells=size.density_cells,
        density_bins=size.density_bins,
        grid=GridSpec(
            levels=size.levels,
            coarsest=size.coarsest,
            finest=size.finest,
            log2_table=size.log2_table,
            channels=size.channels,
        ),
        proposal_grid=GridSpec(
            levels=size.proposal_levels,
            coarsest=size.coarsest,
            finest=size.proposal_finest,
            log2_table=size.proposal_log2_table,
            channels=1,
        ),
        proposal_samples=size.proposal_samples,
        samples=size.samples,
        density_width=size.density_width,
        bottleneck=size.bottleneck,
        view_width=size.view_width,
        view_layers=size.view_layers,
        glo=size.glo,
        far=size.far,
    )
    return planned_spec(
        largest,
        plan,
        views=views,
        centre_depth=centre_depth,
        near_share=size.near_share,
        bound=cube_half_side(points),
    )


def cube_half_side(points: NDArray[np.float32]) -> float:
    """Half side, in scene units, of the cube round the origin that holds the cameras and the sparse points [p, 3].

    What few points lie far beyond all others does not count: the cells would be spent on the space between.
    """
    if not len(points):
        return CUBE_MARGIN
    reach, core = np.percentile(np.abs(points).max(-1), (POINTS_INSIDE, CORE_INSIDE))
    return CUBE_MARGIN * max(1.0, float(core if reach > FAR_BEYOND * core else reach))
