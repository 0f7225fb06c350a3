"""The parameters that size a field, and what one of a given spec consists of: grid levels, the shape of each weight.

Imports no array library: the parameters are checked where no field is made.
"""

from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

from pydantic import Field
from pydantic.config import JsonDict

from inpaint3d.contracts.models.artifacts import EffectPlan, FieldSpec, GridSpec
from inpaint3d.contracts.models.base import Closed, Positive, Share

Count = Annotated[int, Field(ge=1)]
Samples = Annotated[int, Field(ge=2)]
Log2 = Annotated[int, Field(ge=4, le=28)]

# Spherical harmonics of degrees 0 to 3.
DIRECTION_COMPONENTS = 16


# What one sampler alone looks at.
PROPOSAL: JsonDict = {"x-under": {"sampler": "proposal"}}
DENSITY_GRID: JsonDict = {"x-under": {"sampler": "density-grid"}}


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
    density_cells: Count = Field(
        default=96, description="cells per side of the density grid", json_schema_extra=DENSITY_GRID
    )
    density_bins: Samples = Field(
        default=64, description="intervals of a ray that are looked up in it", json_schema_extra=DENSITY_GRID
    )
    proposal_samples: tuple[Samples, ...] = Field(
        default=(48,),
        description="samples a ray of each proposal round; 64, 64 in the paper (N2)",
        json_schema_extra=PROPOSAL,
    )
    proposal_levels: Count = Field(
        default=5, description="resolutions of the proposal's grid; 10 in the paper (N3)", json_schema_extra=PROPOSAL
    )
    proposal_finest: Count = Field(
        default=256, description="cells per side of its finest level; 8192 in the paper", json_schema_extra=PROPOSAL
    )
    proposal_log2_table: Log2 = Field(
        default=16, description="log2 of the entries of its levels; 21 in the paper", json_schema_extra=PROPOSAL
    )
    density_width: Count = Field(default=64, description="width of the density networks (N4)")
    bottleneck: Count = Field(default=15, description="numbers that reach the view-dependent network (N4)")
    view_width: Count = Field(default=64, description="width of the view-dependent network (N4)")
    view_layers: Count = Field(default=2, description="its hidden layers, where the plan has view dependence on (N4)")
    glo: Count = Field(default=4, description="length of the appearance codes, where the plan has exposure on (N6)")
    near_share: Share = Field(default=0.1, description="where rays start, as a share of the capture's centre depth")
    far: Positive = Field(default=1000.0, le=1e6, description="where rays end in an unbounded scene, scene units")


class Level(NamedTuple):
    """One resolution of a hash grid; its vertices lie at (i, j, k) / resolution, 0 <= i, j, k <= resolution."""

    resolution: int  # cells per side
    offset: int  # first entry in the table
    size: int  # entries
    dense: bool  # one entry per vertex, x fastest; else `size` is a power of two and vertices share by hash


def levels_of(levels: int, coarsest: int, finest: int, log2_table: int) -> tuple[Level, ...]:
    """Lay `levels` resolutions, geometric from coarsest to finest, out in one table.

    A level is dense where its (resolution + 1)^3 vertices fit 2^log2_table entries (conformance N3).
    """
    growth = (finest / coarsest) ** (1 / max(levels - 1, 1))
    laid_out: list[Level] = []
    offset = 0
    for index in range(levels):
        resolution = round(coarsest * growth**index)
        dense = (resolution + 1) ** 3 <= 2**log2_table
        size = (resolution + 1) ** 3 if dense else 2**log2_table
        laid_out.append(Level(resolution, offset, size, dense))
        offset += size
    return tuple(laid_out)


def planned_spec(
    size: FieldSpec, plan: EffectPlan, *, views: int, centre_depth: float, near_share: float, bound: float
) -> FieldSpec:
    """`size` with the effects that the plan calls for; what is off is absent from the field, not multiplied by zero.

    views: training views. centre_depth: of the posed capture; the near plane lies at `near_share` of it. bound: half
    side of the cube that holds the scene, used where contraction is off; rays then end behind the cube.
    """
    unbounded, exposure = plan.active("contraction"), plan.active("exposure") and size.glo > 0
    view_dependent = plan.active("view-dependence")
    return size.model_copy(
        update={
            "contraction": unbounded,
            "bound": 1.0 if unbounded else bound,
            "near": near_share * centre_depth,
            # From a camera within the unit ball to the far corner of the cube.
            "far": size.far if unbounded else 1 + 3**0.5 * bound,
            "glo": size.glo if exposure else 0,
            "glo_views": views if exposure else 0,
            "view_layers": size.view_layers if view_dependent else 0,
            "bottleneck": size.bottleneck if view_dependent else 0,
        }
    )


def parameter_shapes(spec: FieldSpec) -> dict[str, tuple[int, ...]]:
    """Name and shape of each tensor of `fields.RadianceField`, networks [out, in]."""
    heads = 1 + 3 + (spec.bottleneck if spec.view_layers else 0)
    if spec.sampler == "proposal":
        shapes = _shape_hash_network("proposal", spec.proposal_grid, [spec.density_width, 1])
    else:
        shapes = {"density_grid.density": (spec.density_cells**3,)}
    shapes |= _shape_hash_network("base", spec.grid, [spec.density_width, heads])
    if spec.view_layers:
        widths = [spec.bottleneck + DIRECTION_COMPONENTS, *[spec.view_width] * spec.view_layers, 3]
        shapes |= {f"specular.{i}": (out, into) for i, (into, out) in enumerate(pairwise(widths))}
    if spec.glo:
        shapes |= {"codes": (max(spec.glo_views, 1), spec.glo), "code_map": (spec.glo, 6)}
    return shapes


def _shape_hash_network(name: str, grid: GridSpec, widths: list[int]) -> dict[str, tuple[int, ...]]:
    levels = levels_of(grid.levels, grid.coarsest, grid.finest, grid.log2_table)
    shapes: dict[str, tuple[int, ...]] = {f"{name}.table": (levels[-1].offset + levels[-1].size, grid.channels)}
    for i, (into, out) in enumerate(pairwise([grid.levels * grid.channels, *widths])):
        shapes[f"{name}.weights.{i}"] = (out, into)
    return shapes
