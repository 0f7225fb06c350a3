"""3D Gaussian splats: what they are, and pictures of them (Kerbl et al. 2023, arXiv:2308.04079).

`reference` is readable torch and the truth; `native` has the CPU's kernels, where they are installed.
"""

from inpaint3d.radiance.splats.model import NEAR, Splats, View, has_kernels, render_splats

__all__ = ["NEAR", "Splats", "View", "has_kernels", "render_splats"]
