"""Mesh, texture and package the inpainted scene."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import CompletedViews, MaskSet, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.store import Artifact
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.rendering import render_view
from inpaint3d.radiance.surface_views import SurfaceView, close_off, surface_view
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import View, load_points, load_posed
from inpaint3d.scene.image_io import Mask
from inpaint3d.scene.selection import choose_evenly
from inpaint3d.stages.usd_export.config import Config
from inpaint3d.stages.usd_export.export import Capture, MaskVolume, Textured, make_content, write_scene
from inpaint3d.stages.usd_export.pictures import load_completed, load_held_out, load_masks, load_photos
from inpaint3d.stages.usd_export.surface import bounds_of


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Fuse the depth of both fields, paint their surfaces from photographs, write and validate the scene."""
    torch.set_num_threads(ctx.threads)
    posed = inputs.one("posed-capture", PosedCapture)
    masks = inputs.one("mask-set", MaskSet)
    completed = inputs.optional("completed-views", CompletedViews)
    fields = {"inpainted": inputs.one("inpainted", RadianceFieldArtifact)}
    if config.original:
        fields["original"] = inputs.one("original", RadianceFieldArtifact)
    views = load_posed(posed)
    drawn = load_masks(masks, views)
    chosen = choose_evenly(views, config.views)
    painting = choose_evenly([view for view in views if view.split == "train"], config.pictures)
    steps = len(fields) * (len(chosen) + 2) + 1
    done = 0

    def tick(message: str) -> None:
        nonlocal done
        done += 1
        ctx.progress(min(done, steps), steps, message)

    folder = outputs.folder("usd-scene")
    made: list[Textured] = []
    box = None
    for name, field in fields.items():
        seen = _load_surface_views(name, field, chosen, config, ctx.device, tick)
        # Both contents share the box of the first, so that switching between them moves nothing.
        box = box or bounds_of(seen)
        pictures = load_photos(painting, drawn) if name == "original" else load_completed(painting, drawn, completed)
        made.append(make_content(name, seen, pictures, box, folder, config))
        tick(f"{name}: {len(made[-1].content.mesh.triangles)} triangles")
    held_out = load_held_out(views, drawn)
    fidelity = made[0].measure(held_out, fields["inpainted"].metadata.held_out_psnr)
    told = posed.metadata.scale
    capture = Capture(
        names=[v.name for v in views],
        cameras=[v.camera for v in views],
        points=load_points(posed.path(posed.metadata.points)),
        metres_per_unit=config.metres_per_unit or (told.metres_per_unit if told else None),
        provenance={"posed-capture": posed.digest, "mask-set": masks.digest, "up": posed.metadata.up_evidence}
        | {f"radiance-field-{name}": field.digest for name, field in fields.items()}
        | ({"completed-views": completed.digest} if completed else {}),
    )
    metadata = write_scene(folder, made, capture, _mask_volume(masks, chosen, drawn), fidelity)
    outputs.write("usd-scene", metadata)
    found = f", {fidelity.psnr:.2f} dB on {fidelity.photos} held-out photos" if fidelity else ""
    ctx.progress(steps, steps, f"{metadata.triangles} triangles{found}, {metadata.validation_errors} validation errors")


def _load_surface_views(
    name: str,
    field: Artifact[RadianceFieldArtifact],
    views: Sequence[View],
    config: Config,
    device: str,
    tick: Callable[[str], None],
) -> list[SurfaceView]:
    """Colour and depth of the field in every view, a dome behind it. BadInputError where no view shows a surface."""
    render = _make_renderer(field, device, config.block)
    seen: list[SurfaceView] = []
    for view in views:
        seen.append(
            surface_view(
                field, view.name, view.camera, render, longest_side=config.render_longest_side, opaque=config.opaque
            )
        )
        tick(f"{name}: depth of {view.name}")
    if not any((view.depth > 0).any() for view in seen):
        raise BadInputError(
            f"the field '{field.metadata.label}' shows no surface in {len(seen)} views; train it longer"
        )
    return [close_off(view) for view in seen]


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


def _mask_volume(masks: Artifact[MaskSet], views: Sequence[View], drawn: Mapping[str, Mask]) -> MaskVolume:
    """The mask's primitives, or else the masks of the chosen views to carve its hull from."""
    if masks.metadata.primitives:
        return MaskVolume(masks.metadata.primitives, [], [])
    return MaskVolume((), [view.camera for view in views], [drawn[view.name] for view in views])
