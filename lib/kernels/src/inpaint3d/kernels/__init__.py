"""Compiled CPU kernels of the radiance field; `inpaint3d.radiance.backends.native` is their only user.

Arrays are float32, contiguous, and used in place (numpy, or anything that speaks DLPack). `threads` never changes a
result: each output number is summed by one thread in a fixed order. Wrong shapes and indices raise ValueError or
TypeError. Importing this package raises ImportError where it was installed without a C++ compiler.
"""

from inpaint3d.kernels._native import (
    MOST_RUN,
    adam,
    colours_backward,
    colours_forward,
    composite_backward,
    composite_forward,
    grid_histogram,
    grid_learn,
    hash_backward,
    hash_forward,
    interlevel_backward,
    interlevel_forward,
    isa,
    isas,
    mlp_backward,
    mlp_forward,
    resample,
    set_isa,
    unit_cube,
)
from inpaint3d.kernels.arguments import (
    Cells,
    ColourMap,
    Colours,
    Histogram,
    Logits,
    Network,
    Rays,
    Rendered,
    SampleGradients,
    Samples,
)

__all__ = [
    "MOST_RUN",
    "Cells",
    "ColourMap",
    "Colours",
    "Histogram",
    "Logits",
    "Network",
    "Rays",
    "Rendered",
    "SampleGradients",
    "Samples",
    "adam",
    "colours_backward",
    "colours_forward",
    "composite_backward",
    "composite_forward",
    "grid_histogram",
    "grid_learn",
    "hash_backward",
    "hash_forward",
    "interlevel_backward",
    "interlevel_forward",
    "isa",
    "isas",
    "mlp_backward",
    "mlp_forward",
    "resample",
    "set_isa",
    "unit_cube",
]
