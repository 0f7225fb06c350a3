"""What makes a USD stage broken although it opens: refused before anything is committed."""

# pxr ships no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from inpaint3d.contracts.errors import Inpaint3dError, NonFiniteError


class BrokenStageError(Inpaint3dError):
    """A stage that was written holds what no tool may be given."""


def refuse_broken(folder: Path, files: Sequence[str]) -> None:
    """Look at every value of every variant of some files of a folder.

    Raises NonFiniteError for a number that is not finite; BrokenStageError for an extent that is not that of the
    points, for a layer or a texture that is missing, and for a path that is absolute or leads out of the folder.
    """
    for name in files:
        stage = Usd.Stage.Open(str(folder / name))
        for variant in _select_variants(stage):
            if lost := stage.GetCompositionErrors():
                raise BrokenStageError(f"{name}{variant} a layer does not load: {lost[0]}")
            for prim in stage.Traverse():
                place = f"{name}{variant}{prim.GetPath()}"
                _check_values(prim, place)
                _check_extent(prim, place)


def _select_variants(stage: Usd.Stage) -> Iterator[str]:
    """Walk through the variants of the default prim's sets, with '' for none."""
    sets = stage.GetDefaultPrim().GetVariantSets() if stage.GetDefaultPrim() else None
    names = sets.GetNames() if sets else []
    if not sets or not names:
        yield ":"
        return
    for name in names:
        chosen = sets.GetVariantSet(name)
        stage.SetEditTarget(stage.GetSessionLayer())
        for variant in chosen.GetVariantNames():
            chosen.SetVariantSelection(variant)
            yield f" ({variant}):"


def _check_values(prim: Usd.Prim, place: str) -> None:
    for attribute in prim.GetAuthoredAttributes():
        for time in attribute.GetTimeSamples() or [Usd.TimeCode.Default()]:
            value = attribute.Get(time)
            if isinstance(value, Sdf.AssetPath):
                _check_asset(value, f"{place}.{attribute.GetName()}")
            elif value is not None and not isinstance(value, str | bool):
                _check_finite(value, f"{place}.{attribute.GetName()}")


def _check_finite(value: object, place: str) -> None:
    numbers = np.asarray(value)
    if numbers.dtype.kind == "f" and (strange := int((~np.isfinite(numbers)).sum())):
        raise NonFiniteError(f"{place}: {strange} numbers are not finite; the field or a camera is damaged")


def _check_asset(asset: Sdf.AssetPath, place: str) -> None:
    path = PurePosixPath(asset.path)
    if path.is_absolute() or ".." in path.parts or ":" in asset.path:
        raise BrokenStageError(f"{place}: {asset.path} leads out of the scene's folder; give a path relative to it")
    if not asset.resolvedPath:
        raise BrokenStageError(f"{place}: there is no file {asset.path}; write it beside the layer")


def _check_extent(prim: Usd.Prim, place: str) -> None:
    if not prim.IsA(UsdGeom.PointBased):
        return
    told = UsdGeom.Boundable(prim).GetExtentAttr().Get()
    found = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), Usd.TimeCode.Default())
    if told is None or found is None or not np.allclose(np.asarray(told), np.asarray(found), rtol=1e-5, atol=1e-6):
        raise BrokenStageError(f"{place}: the extent is {told}, the points' is {found}; compute it from the points")
