"""What the report says of the files that people take on."""

from inpaint3d.contracts.models.artifacts import CleanPlates, MeshFidelity, SplatScene, UsdScene
from inpaint3d.contracts.models.artifacts.plates import PlateConsistency
from inpaint3d.contracts.models.artifacts.splat_scene import SplatFidelity
from inpaint3d.orchestrator.pages.exports import describe_plates, describe_scene, describe_splats

SCENE = UsdScene(
    triangles=20_000, charts=1_234, texel_use=0.6, collision_pieces=128, cameras=50, variants=("inpainted", "original"),
    bounds_min=(0, 0, 0), bounds_max=(1, 1, 1), validation_errors=0,
)  # fmt: skip


def test_the_mesh_stands_beside_its_field() -> None:
    fit = MeshFidelity(photos=7, psnr=25.56, ssim=0.791, field_psnr=26.16)
    told = describe_scene(SCENE.model_copy(update={"fidelity": fit}))
    assert told.holds == (
        "20,000 triangles in 1,234 charts, 50 cameras, 128 convex pieces that bodies collide with; "
        "variants: inpainted, original"
    )
    assert told.measured == (
        "the mesh is 25.6 dB, SSIM 0.79, from 7 photos that were held out (the radiance field: 26.2 dB); "
        "0 errors of USD's validators"
    )


def test_a_mesh_without_photos_to_compare_says_so() -> None:
    assert describe_scene(SCENE).measured == (
        "no photo was held out to compare the mesh with; 0 errors of USD's validators"
    )


def test_plates_tell_how_alike_they_are() -> None:
    made = CleanPlates(plates=(), model=())
    assert describe_plates(made).measured == "no two plates show the same"
    alike = PlateConsistency(hole=0.0282, known=0.0243, ratio=1.1591, pairs=50)
    told = describe_plates(made.model_copy(update={"consistency": alike}))
    assert told.measured == "neighbouring plates differ 1.16 times as much in the hole as beside it, over 50 pairs"


def test_splats_stand_beside_the_field_too() -> None:
    fit = SplatFidelity(photos=1, psnr=29.39, ssim=0.894, lpips_vgg=0.134, field_psnr=26.16)
    files = {"ply": "splats.ply", "spz": "splats.spz"}
    made = SplatScene.model_validate(
        {"files": files, "splats": 117_680, "fidelity": fit, "bounds_min": (0, 0, 0), "bounds_max": (1, 1, 1)}
    )
    told = describe_splats(made)
    assert told.holds == "117,680 Gaussian splats as PLY, SPZ"
    assert told.measured == (
        "they are 29.4 dB, SSIM 0.89, from 1 photo that was held out (the radiance field: 26.2 dB)"
    )
