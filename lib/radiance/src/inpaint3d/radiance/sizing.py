"""The field that the parameters of its size and an effect plan make."""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import EffectPlan, FieldSpec, GridSpec
from inpaint3d.radiance.architecture import Architecture, planned_spec
from inpaint3d.scene.effects.contraction import cube_half_side


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
