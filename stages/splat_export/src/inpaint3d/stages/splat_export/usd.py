"""Splats as a USD layer with a ParticleField3DGaussianSplat (UsdVol, since OpenUSD 26.03)."""

# pxr ships no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, UsdVol, Vt

from inpaint3d.stages.splat_export.cloud import SplatCloud

ROOT = "/Scene"
REACH = 3.0  # standard deviations that the extent holds


def write_layer(path: Path, cloud: SplatCloud, metres_per_unit: float | None, provenance: Mapping[str, str]) -> None:
    """Z up, scene units. What the splats were made of, name to digest, becomes customLayerData.

    Where the scale is unknown, the layer says so beside the metersPerUnit of 1 that USD's validators ask for.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit or 1.0)
    known = "unknown" if metres_per_unit is None else "known"
    told = {f"inpaint3d:{name}": value for name, value in sorted(provenance.items())}
    stage.GetRootLayer().customLayerData = {"inpaint3d:scale": known} | told
    root = UsdGeom.Xform.Define(stage, ROOT).GetPrim()
    stage.SetDefaultPrim(root)
    Usd.ModelAPI(root).SetKind("component")
    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, f"{ROOT}/Splats")
    field.CreatePositionsAttr(_vectors(cloud.mean))
    field.CreateOrientationsAttr(Vt.QuatfArray.FromNumpy(np.roll(cloud.quaternion, -1, axis=1)))
    scales = np.exp(cloud.log_scale)
    field.CreateScalesAttr(_vectors(scales))
    field.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(cloud.alpha))
    field.CreateRadianceSphericalHarmonicsDegreeAttr(0)
    field.CreateRadianceSphericalHarmonicsCoefficientsAttr(_vectors(cloud.coefficients))
    field.CreateSortingModeHintAttr("cameraDistance")
    reach = REACH * scales.max(1, keepdims=True)
    field.CreateExtentAttr(_vectors(np.stack([(cloud.mean - reach).min(0), (cloud.mean + reach).max(0)])))
    colours = field.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    colours.Set(_vectors(cloud.rgb))
    stage.GetRootLayer().Save()


def _vectors(array: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array, np.float32))
