"""The reference through torch.compile, for accelerators: a few fused kernels where eager torch launches dozens.

What takes a number that is another at every step (the learning rate, the share of specular colour) or writes in place
stays as it is: each new number would be compiled anew.
"""

from functools import cache

import torch

from inpaint3d.radiance.backends import reference
from inpaint3d.radiance.backends.reference import Level, adam_step, colours, grid_learn, levels_of

__all__ = [
    "Level", "adam_step", "can_compile", "colours", "composite", "grid_histogram", "grid_learn", "hash_encode",
    "interlevel", "levels_of", "mlp", "resample", "unit_cube",
]  # fmt: skip

# Rays are as many as a patch or a photo has: their number is no constant.
hash_encode = torch.compile(reference.hash_encode, dynamic=True)
mlp = torch.compile(reference.mlp, dynamic=True)
composite = torch.compile(reference.composite, dynamic=True)
resample = torch.compile(reference.resample, dynamic=True)
unit_cube = torch.compile(reference.unit_cube, dynamic=True)
interlevel = torch.compile(reference.interlevel, dynamic=True)
grid_histogram = torch.compile(reference.grid_histogram, dynamic=True)


@cache
def can_compile(device_type: str) -> bool:
    """Whether this machine can compile for a device: images that ship no compiler cannot. Tries it, once."""
    if device_type == "cuda" and not torch.cuda.is_available():
        return False
    try:
        torch.compile(_try_out)(torch.zeros(8, device=device_type))
    except RuntimeError:  # every error of torch.compile is one
        return False
    return True


def _try_out(x: torch.Tensor) -> torch.Tensor:
    return x.sin() + 1
