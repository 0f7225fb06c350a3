"""The files of a splat-scene, and what its metadata says. Importing this takes no tensor library."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import SplatFidelity, SplatFormat, SplatScene
from inpaint3d.stages.splat_export.cloud import SplatCloud
from inpaint3d.stages.splat_export.gltf import write_glb
from inpaint3d.stages.splat_export.ply import write_ply
from inpaint3d.stages.splat_export.spz import write_spz
from inpaint3d.stages.splat_export.usd import write_layer


def write_splats(
    folder: Path,
    cloud: SplatCloud,
    formats: Sequence[SplatFormat],
    *,
    metres_per_unit: float | None = None,
    provenance: Mapping[str, str] | None = None,
    fidelity: SplatFidelity | None = None,
) -> SplatScene:
    """Write `splats.FORMAT` for each format; returns the artifact's metadata. Equal splats give equal bytes."""
    files: dict[SplatFormat, str] = {one: f"splats.{one}" for one in formats}
    for one, file in files.items():
        match one:
            case "ply":
                write_ply(folder / file, cloud)
            case "spz":
                write_spz(folder / file, cloud)
            case "glb":
                write_glb(folder / file, cloud)
            case "usdc":
                write_layer(folder / file, cloud, metres_per_unit, provenance or {})
    return SplatScene(
        files=files,
        splats=len(cloud),
        fidelity=fidelity,
        bounds_min=_to_vector(cloud.mean.min(0)),
        bounds_max=_to_vector(cloud.mean.max(0)),
        metres_per_unit=metres_per_unit,
    )


def _to_vector(corner: NDArray[np.float32]) -> tuple[float, float, float]:
    return float(corner[0]), float(corner[1]), float(corner[2])
