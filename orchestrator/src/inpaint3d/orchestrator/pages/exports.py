"""What a run hands on, and how far it is from the photographs, in sentences."""

from dataclasses import dataclass

from inpaint3d.contracts.models.artifacts import CleanPlates, SplatScene, UsdScene


@dataclass(frozen=True)
class Export:
    """A file or a folder of the run's folder, what it holds, and what was measured of it."""

    place: str
    holds: str
    measured: str


def describe_scene(scene: UsdScene) -> Export:
    """The USD scene: its mesh beside the field that it was made of."""
    holds = (
        f"{scene.triangles:,} triangles in {scene.charts:,} charts, {scene.cameras} cameras, "
        f"{scene.collision_pieces} convex pieces that bodies collide with; variants: {', '.join(scene.variants)}"
    )
    errors = f"{scene.validation_errors} errors of USD's validators"
    if (fit := scene.fidelity) is None:
        return Export("scene.usdz", holds, f"no photo was held out to compare the mesh with; {errors}")
    apart = _compare("the mesh is", fit.psnr, fit.ssim, fit.photos, fit.field_psnr)
    return Export("scene.usdz", holds, f"{apart}; {errors}")


def describe_splats(made: SplatScene) -> Export:
    """The Gaussian splats beside the field that they start from."""
    holds = f"{made.splats:,} Gaussian splats as {', '.join(name.upper() for name in made.files)}"
    if (fit := made.fidelity) is None:
        return Export("splats", holds, "no photo was held out to compare them with")
    return Export("splats", holds, _compare("they are", fit.psnr, fit.ssim, fit.photos, fit.field_psnr))


def describe_plates(made: CleanPlates) -> Export:
    """The plates: how alike they are in the hole."""
    holds = f"{len(made.plates)} photos at their own size, as a data set with COLMAP's model and transforms.json"
    if made.consistency is None:
        return Export("plates", holds, "no two plates show the same")
    return Export(
        "plates",
        holds,
        f"neighbouring plates differ {made.consistency.ratio:.2f} times as much in the hole as beside it, "
        f"over {made.consistency.pairs} pairs",
    )


def _compare(what: str, psnr: float, ssim: float, photos: int, field_psnr: float | None) -> str:
    of = "1 photo that was" if photos == 1 else f"{photos} photos that were"
    field = "" if field_psnr is None else f" (the radiance field: {field_psnr:.1f} dB)"
    return f"{what} {psnr:.1f} dB, SSIM {ssim:.2f}, from {of} held out{field}"
