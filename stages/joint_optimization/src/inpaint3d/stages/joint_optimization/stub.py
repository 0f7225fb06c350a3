"""A tiny valid radiance field of the synthetic room without its ball, through the same writers; no tensor library."""

from safetensors.numpy import save_file

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import CompletedViews, FieldSpec, GridSpec, RadianceFieldArtifact
from inpaint3d.radiance.artifact import stub_weights, write_curve, write_view
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.joint_optimization.config import Config

SPEC = FieldSpec(
    grid=GridSpec(levels=3, coarsest=4, finest=16, log2_table=10, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=10, channels=1),
    proposal_samples=(8,),
    samples=8,
    density_width=8,
    bottleneck=0,
    view_layers=0,
    far=10.0,
)


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """The renders are the room's truth; the weights are random, of the right names and shapes."""
    scene = synthetic_scene()
    completed = inputs.optional("completed-views", CompletedViews)
    folder = outputs.folder("radiance-field")
    save_file(stub_weights(SPEC, ctx.seed), folder / "weights.safetensors")
    write_curve(folder, [[1, 100, 0.5, float("nan")], [2, 200, 0.25, 20.0]])
    views = [
        write_view(
            folder, name, camera, {"rgb": image, "depth": depth, "median_depth": depth, "opacity": 0 * depth + 1}
        )
        for name, camera, image, depth in zip(
            scene.names, scene.cameras, scene.empty_images, scene.empty_depths, strict=True
        )
    ]
    outputs.write(
        "radiance-field",
        RadianceFieldArtifact(
            label=config.estimator.label(
                continued=inputs.optional("initial-field", RadianceFieldArtifact) is not None,
                completion=completed.metadata.method if completed else None,
            ),
            spec=SPEC,
            views=tuple(views),
            steps=2,
            seed=ctx.seed,
            backend="stub",
            held_out_psnr=20.0,
            decisions={"diffuse-only-start": "off: this is a stub"},
        ),
    )
    ctx.progress(1, 1, "stub")
