"""Shadows that are found around a removed object, against pictures of the same scene without it.

    python -m benchmarks.shadows STORE METRICS CLEAN [--completion]

STORE and METRICS (`metrics.json`) are of a run of the demo; CLEAN holds the scene without the figure, by the photos'
own cameras (`examples/demo/render.py --clean`: renderer/clean). The truth is where photo minus render, blurred by two
pixels, is under -0.03 outside the object's mask. `--completion` also completes the views with both masks. Writes
`benchmarks/results/shadows.json`.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from benchmarks.provenance import commit

from inpaint3d.contracts.models.artifacts import EffectPlan, MaskSet, PosedCapture, PosedFrame, RadianceFieldArtifact
from inpaint3d.contracts.store import FolderStore
from inpaint3d.radiance.appearance import AppearanceMap
from inpaint3d.radiance.io import load_field
from inpaint3d.scene.image_io import Image, Mask, read_image, read_mask
from inpaint3d.scene.masked_views import load_masked_scene
from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.visibility import load_depth_maps
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.scene import Scene, load_scene
from inpaint3d.stages.mask_authoring.shadows import Shadow, find_shadows, show_shadow
from inpaint3d.stages.mask_authoring.surroundings import find_planes
from inpaint3d.stages.mask_authoring.views import DepthView
from inpaint3d.stages.plate_export.lens import PhotoCamera
from inpaint3d.stages.view_completion.config import PhotoCompletion
from inpaint3d.stages.view_completion.photo_completion import complete_from_photos

RESULTS = Path(__file__).parent / "results" / "shadows.json"
DARKER, BLUR = 0.03, 2.0
FINER = 4  # samples of the render along a pixel's side


class Demo:
    """Artifacts of a run, and the renders without the figure as the posed frames see them."""

    def __init__(self, store: Path, metrics: Path, clean: Path) -> None:
        self._store = FolderStore(store)
        stages = json.loads(metrics.read_text())["stages"]
        self._outputs = {stage["node"]: stage["outputs"] for stage in stages}
        self.posed = self._open("pose-estimation", "posed-capture", PosedCapture)
        self.masks = self._open("mask-authoring", "mask-set", MaskSet)
        self.plan = self._open("scene-analysis", "effect-plan", EffectPlan)
        self.scene: Scene = load_scene(
            self.posed, self._open("nerf-pretraining", "radiance-field", RadianceFieldArtifact)
        )
        self.known = self._open("masked-reconstruction", "radiance-field", RadianceFieldArtifact)
        known = [frame for frame in self.posed.metadata.frames if (clean / f"{frame.name}.png").is_file()]
        self.truth = {frame.name: self._resample(frame, clean / f"{frame.name}.png") for frame in known}

    def object_masks(self) -> list[Mask]:
        return [read_mask(self.masks.path(view.mask)) for view in self.masks.metadata.views]

    def _open(self, node: str, port: str, kind: type[Any]) -> Any:
        return self._store.open(self._outputs[node][port], kind)

    def _resample(self, frame: PosedFrame, path: Path) -> Image:
        """The render at a posed frame's size, its lens straightened."""
        render = read_image(path)
        camera = PhotoCamera.from_frame(frame, self.posed.metadata.lens, render.shape[1], render.shape[0])
        posed = next(v.camera for v in self.scene.views if v.name == frame.name)
        rows, columns = np.mgrid[0 : posed.height * FINER, 0 : posed.width * FINER]
        rays = ((np.stack([columns, rows], -1) + 0.5) / FINER - (posed.cx, posed.cy)) / (posed.fx, posed.fy)
        at = camera.project(rays.reshape(-1, 2)).reshape(*rows.shape, 2).astype(np.float32) - np.float32(0.5)
        fine = cv2.remap(render, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        return fine.reshape(posed.height, FINER, posed.width, FINER, 3).mean((1, 3))


def find_darker(photo: Image, render: Image, mask: Mask) -> Mask:
    """Where the photo is darker than the render without the object, outside its mask [h, w]."""
    difference = np.where(mask, 0.0, (photo - render).mean(-1))
    weight = cv2.GaussianBlur((~mask).astype(np.float64), (0, 0), BLUR)
    return (cv2.GaussianBlur(difference, (0, 0), BLUR) / np.maximum(weight, 0.05) < -DARKER) & ~mask


def measure_overlap(found: Sequence[Mask], truth: Sequence[Mask]) -> dict[str, float]:
    """Of all pixels of all views together."""
    both, either, own, real = (
        float(sum(m.sum() for m in part))
        for part in (
            [f & t for f, t in zip(found, truth, strict=True)],
            [f | t for f, t in zip(found, truth, strict=True)],
            found,
            truth,
        )
    )
    return {
        "iou": round(both / max(1, either), 3),
        "precision": round(both / max(1, own), 3),
        "recall": round(both / max(1, real), 3),
    }


def describe(shadows: Sequence[Shadow]) -> list[dict[str, float | bool]]:
    return [
        {
            "found": s.found,
            "darkest": round(s.darkest, 3),
            "threshold": round(s.threshold, 3),
            "log_likelihood": round(s.gain, 1),
            "log_likelihood_by_chance": round(s.chance_gain, 1),
        }
        for s in shadows
    ]


def measure_demo(demo: Demo) -> tuple[dict[str, Any], list[Mask]]:
    """All photos; the renders without the figure under the same masks, where no shadow is; and the grown masks."""
    scene, masks = demo.scene, demo.object_masks()
    planes = find_planes(scene.points, scene.small(Config().segment_size))
    shadows = find_shadows(planes, scene.depth_views, masks)
    cast = [
        np.logical_or.reduce([np.zeros_like(m), *(show_shadow(s, v) for s in shadows if s.found)]) & ~m
        for v, m in zip(scene.depth_views, masks, strict=True)
    ]
    rows = [i for i, v in enumerate(scene.depth_views) if v.name in demo.truth]
    views = [scene.depth_views[i] for i in rows]
    truth = [find_darker(v.image(), demo.truth[v.name], masks[i]) for i, v in zip(rows, views, strict=True)]
    by_view = {
        v.name: measure_overlap([cast[i]], [t]) | {"added": round(float(cast[i].mean()), 5)}
        for i, v, t in zip(rows, views, truth, strict=True)
    }
    found = {
        "views": len(scene.views),
        "planes": describe(shadows),
        "overlap": measure_overlap([cast[i] for i in rows], truth),
        "by_view": by_view,
        "same_views_without_figure": describe(
            find_shadows(planes, [_show(v, demo.truth) for v in views], [masks[i] for i in rows])
        ),
        "same_views_with_figure": describe(find_shadows(planes, views, [masks[i] for i in rows])),
    }
    return found, [m | c for m, c in zip(masks, cast, strict=True)]


def _show(view: DepthView, pictures: Mapping[str, Image]) -> DepthView:
    return replace(view, image=lambda: pictures[view.name].astype(np.float32))


def measure_completion(demo: Demo, grown: Sequence[Mask]) -> dict[str, float]:
    """PSNR of completed views against the renders, in the union of object and shadow of all views together."""
    scene = load_masked_scene(demo.posed, demo.masks, demo.plan, whole_frames=False, whole_mask=True)
    larger = dict(zip([v.name for v in demo.scene.views], grown, strict=True))
    depths = load_depth_maps(scene.train, demo.known)
    exposure = demo.plan.metadata.active("exposure")
    field = load_field(demo.known.path(demo.known.metadata.weights), demo.known.metadata.spec) if exposure else None
    with_shadow = [
        replace(
            v,
            hole=larger[v.name],
            known=v.known & ~larger[v.name],
            image=np.where((v.known & ~larger[v.name])[..., None], v.image, np.float32(0)),
        )
        for v in scene.train
    ]
    found = {}
    for name, views in (("object", scene.train), ("object_and_shadow", with_shadow)):
        made, _, _, _ = complete_from_photos(
            views, depths, scene.points, AppearanceMap(field), PhotoCompletion(), seed=0
        )
        pairs = [(m.picture, demo.truth[m.name], larger[m.name]) for m in made if m.name in demo.truth]
        made_there, true_there = (np.concatenate([p[k][p[2]] for p in pairs]) for k in (0, 1))
        found[name] = round(psnr(made_there, true_there), 2)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("store", "metrics", "clean"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--completion", action="store_true")
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args()
    demo = Demo(given.store, given.metrics, given.clean)
    found, grown = measure_demo(demo)
    found["provenance"] = {"code": commit()}
    given.out.write_text(json.dumps(found, indent=1) + "\n")
    if given.completion:
        found["psnr_in_object_and_shadow"] = measure_completion(demo, grown)
    given.out.write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
