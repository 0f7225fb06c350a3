"""The synthetic room as a posed capture and posed truth: exact cameras, depth-true points."""

from inpaint3d.contracts.artifacts import LensModel, PosedCapture, PosedTruth, Registration
from inpaint3d.contracts.context import Context, Inputs, Outputs
from inpaint3d.scene.cameras import as_pose
from inpaint3d.scene.capture_io import write_points, write_view
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.pose_estimation.config import Config

TRUTH_VIEWS = (1, 4, 6)
IDENTITY = as_pose([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Valid outputs without looking for anything."""
    scene = synthetic_scene()
    folder = outputs.folder("posed-capture")
    frames = tuple(
        write_view(folder, name, image, camera, split="test" if i == 4 else "train")
        for i, (name, image, camera) in enumerate(zip(scene.names, scene.images, scene.cameras, strict=True))
    )
    write_points(folder / "points.safetensors", scene.points)
    count = len(frames)
    outputs.write(
        "posed-capture",
        PosedCapture(
            frames=frames,
            ordered=True,
            lens=LensModel(model="PINHOLE", params=(), evidence="synthetic"),
            registration=Registration(
                source="known", given=count, registered=count, mean_reprojection_error_px=0.0,
                points=len(scene.points), median_triangulation_angle_deg=20.0,
            ),
            source_from_normalised_scale=1.0,
            source_from_normalised=IDENTITY,
            centre_depth=0.9,
            up_evidence="synthetic",
        ),
    )  # fmt: skip
    folder = outputs.folder("posed-truth")
    kept = tuple(
        write_view(folder, f"truth_{i:03d}", scene.empty_images[i], scene.cameras[i], split="test") for i in TRUTH_VIEWS
    )
    outputs.write("posed-truth", PosedTruth(frames=kept, registered_share=1.0, mean_reprojection_error_px=0.0))
    ctx.progress(1, 1)
