"""The field that the parameters of its size and an effect plan make."""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import EffectPlan, FieldSpec, GridSpec
from inpaint3d.radiance.architecture import Architecture, planned_spec

# Without contraction the cube is just large enough for this percentage of the sparse points (outliers would make it far
# too large), times the margin.
POINTS_INSIDE, CUBE_MARGIN = 99.0, 1.1
# Scene analysis calls a scene bounded that has up to 2 % of its points far away. Where these reach this many times as
# far as all but 3 %, the cube leaves them out.
CORE_INSIDE, FAR_BEYOND = 97.0, 2.0


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
