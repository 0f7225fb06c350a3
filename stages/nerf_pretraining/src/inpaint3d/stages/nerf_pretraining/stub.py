"""A tiny valid field of the synthetic room, through the same writers: true depths, random weights; no torch."""

import numpy as np
from safetensors.numpy import save_file

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec, RadianceFieldArtifact
from inpaint3d.radiance.artifact import stub_weights, write_curve, write_view
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.nerf_pretraining.config import Config

SPEC = FieldSpec(
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(4,),
    grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=2),
    samples=4,
    density_width=8,
    bottleneck=4,
    view_width=8,
    view_layers=1,
)


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """Depths of the synthetic room are true; the weights are not those of a field that shows it."""
    scene = synthetic_scene()
    folder = outputs.folder("radiance-field")
    views = []
    for name, camera, image, depth in zip(scene.names, scene.cameras, scene.images, scene.depths, strict=True):
        maps = {"rgb": image, "depth": depth, "median_depth": depth, "opacity": np.ones_like(depth)}
        views.append(write_view(folder, name, camera, maps))
    save_file(stub_weights(SPEC, ctx.seed), folder / "weights.safetensors")
    write_curve(folder, [[1, 1, 0.0, float("nan")]])
    metadata = RadianceFieldArtifact(
        label="pretrained", spec=SPEC, views=tuple(views), steps=1, seed=ctx.seed, backend="reference"
    )
    outputs.write("radiance-field", metadata)
    ctx.progress(1, 1, "stub")
