"""Mesh, texture and package the inpainted scene."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import MaskSet, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.store import Artifact
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.rendering import render_view
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import load_posed
from inpaint3d.scene.image_io import read_mask
from inpaint3d.scene.selection import choose_evenly
from inpaint3d.stages.usd_export.config import Config
from inpaint3d.stages.usd_export.export import MaskVolume, make_content, write_scene
from inpaint3d.stages.usd_export.layer import Content
from inpaint3d.stages.usd_export.surface_views import SurfaceView, bounds_of, surface_view


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Fuse the depth of both fields, bake their colours, write and validate the scene."""
    torch.set_num_threads(ctx.threads)
    capture = inputs.one("posed-capture", PosedCapture)
    masks = inputs.one("mask-set", MaskSet)
    fields = {"inpainted": inputs.one("inpainted", RadianceFieldArtifact)}
    if config.original:
        fields["original"] = inputs.one("original", RadianceFieldArtifact)
    views = load_posed(capture)
    chosen = choose_evenly(range(len(views)), config.views)
    steps = len(fields) * (len(chosen) + 2) + 2

    done = 0

    def tick(message: str) -> None:
        nonlocal done
        done += 1
        ctx.progress(min(done, steps), steps, message)

    folder = outputs.folder("usd-scene")
    contents: list[Content] = []
    bounds = None
    for name, field in fields.items():
        render = _make_renderer(field, ctx.device, config.block)
        seen: list[SurfaceView] = []
        for i in chosen:
            seen.append(
                surface_view(
                    field, views[i].name, views[i].camera, render,
                    longest_side=config.render_longest_side, opaque=config.opaque,
                )
            )  # fmt: skip
            tick(f"{name}: depth of {views[i].name}")
        # Both contents share the box of the first, so that switching between them moves nothing.
        bounds = bounds or bounds_of(seen, config.reach)
        if bounds is None:
            raise BadInputError(
                f"the field '{field.metadata.label}' shows no surface within {config.reach} scene units in "
                f"{len(seen)} views; train it longer, or raise reach"
            )
        contents.append(make_content(name, seen, bounds, folder, config))
        tick(f"{name}: {len(contents[-1].mesh.triangles)} triangles")
    mask = _mask_volume(masks, [views[i].name for i in chosen], [views[i].camera for i in chosen])
    told = capture.metadata.scale
    metres = config.metres_per_unit or (told.metres_per_unit if told else None)
    metadata = write_scene(folder, contents, [v.name for v in views], [v.camera for v in views], mask, metres)
    tick("validated")
    outputs.write("usd-scene", metadata)
    ctx.progress(steps, steps, f"{metadata.triangles} triangles, {metadata.validation_errors} validation errors")


def _make_renderer(
    artifact: Artifact[RadianceFieldArtifact], device: str, block: int
) -> Callable[[Camera], dict[str, NDArray[np.float32]]]:
    """Renders views of the field, which is loaded when the first is asked for: stored views need no network."""
    loaded = []

    def render(camera: Camera) -> dict[str, NDArray[np.float32]]:
        if not loaded:
            weights: Path = artifact.path(artifact.metadata.weights)
            loaded.append(load_field(weights, artifact.metadata.spec).to(device).eval())
        return render_view(loaded[0], camera, block=block)

    return render


def _mask_volume(masks: Artifact[MaskSet], names: list[str], cameras: list[Camera]) -> MaskVolume:
    """The mask's primitives, or else the masks of the chosen views to carve its hull from."""
    if masks.metadata.primitives:
        return MaskVolume(masks.metadata.primitives, [], [])
    files = {view.name: view.mask for view in masks.metadata.views}
    if missing := [name for name in names if name not in files]:
        raise BadInputError(
            f"mask-set has no mask for view {missing[0]} ({len(missing)} in all); re-run mask-authoring"
        )
    drawn = [read_mask(masks.path(files[name])) for name in names]
    scaled = [camera.resize_to(mask.shape[1], mask.shape[0]) for camera, mask in zip(cameras, drawn, strict=True)]
    return MaskVolume((), scaled, drawn)
