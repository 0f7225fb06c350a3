"""The synthetic room as a posed capture: exact cameras, points and masks; the truth is the room without its ball."""

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import LensModel, PosedCapture, PosedTruth, Registration
from inpaint3d.scene.capture_io import write_points, write_view
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.pose_estimation.config import Config


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """Eight small views, every eighth (the first) kept for tests, and three truth views."""
    scene = synthetic_scene()
    folder = outputs.folder("posed-capture")
    views = zip(scene.names, scene.images, scene.cameras, scene.object_masks, strict=True)
    frames = tuple(
        write_view(folder, name, image, camera, mask=mask, split="test" if i % 8 == 0 else "train")
        for i, (name, image, camera, mask) in enumerate(views)
    )
    write_points(folder / "points.safetensors", scene.points)
    camera = scene.cameras[0]
    metadata = PosedCapture(
        frames=frames,
        ordered=True,
        lens=LensModel(
            model="PINHOLE", params=(camera.fx, camera.fy, camera.cx, camera.cy), evidence="exact: made without a lens"
        ),
        registration=Registration(
            source="known",
            given=len(frames),
            registered=len(frames),
            mean_reprojection_error_px=0.0,
            points=len(scene.points),
            median_triangulation_angle_deg=20.0,
        ),
        source_from_normalised_scale=1.0,
        source_from_normalised=((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)),
        centre_depth=0.85,
        up_evidence="exact: made with z up",
    )
    outputs.write("posed-capture", metadata)

    empty = synthetic_scene(views=3, arc_deg=70.0)
    folder = outputs.folder("posed-truth")
    frames = tuple(
        write_view(folder, f"truth_{i:03d}", image, camera, split="test")
        for i, (image, camera) in enumerate(zip(empty.empty_images, empty.cameras, strict=True))
    )
    outputs.write("posed-truth", PosedTruth(frames=frames, registered_share=1.0, mean_reprojection_error_px=0.0))
    ctx.progress(1, 1, "stub")
