"""Mask-authoring on the synthetic room, whose depth, cameras and object masks are exact."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import (
    FieldSpec,
    FieldView,
    LensModel,
    MaskRequest,
    MaskRequestArtifact,
    MaskSet,
    PosedCapture,
    PosedTruth,
    RadianceFieldArtifact,
    Registration,
)
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.scene.capture_io import write_points, write_view
from inpaint3d.scene.image_io import read_mask, write_png
from inpaint3d.scene.map_io import write_exr
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.run import run
from tests.conftest import REPOSITORY

STAGE = load_stage(REPOSITORY / "stages" / "mask_authoring" / "stage.yaml")
IDENTITY = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
FAST = Config(segment_size=120, voxels=54)


@dataclass(frozen=True)
class Bench:
    """A store with the room as posed capture and pretrained field."""

    store: Store
    scene: SyntheticScene
    inputs: dict

    def author(
        self, request: dict | None, config: Config = FAST, dilate: float = 0.0, shadows: bool = False, **more
    ) -> tuple[MaskSet, Path]:
        inputs = self.inputs | more
        if request is not None:
            wanted = MaskRequest.model_validate({"mask": request, "dilate": dilate, "shadows": shadows})
            folder = self.store.private_folder()
            inputs["mask-request"] = self.store.put(folder, "mask-request", MaskRequestArtifact(request=wanted))
        outputs = Outputs(self.store, STAGE)
        work = self.store.private_folder()
        ctx = Context(seed=0, device="cpu", threads=1, work=work, emit=lambda event, **values: None)
        run(config, Inputs(self.store, STAGE, inputs), outputs, ctx)
        artifact = self.store.open(outputs.store_all()["mask-set"], MaskSet)
        return artifact.metadata, artifact.root

    def masks(self, request: dict | None, **more) -> list[np.ndarray]:
        metadata, root = self.author(request, **more)
        return [read_mask(root / v.mask) for v in metadata.views]


def capture(store: Store, scene: SyntheticScene, masked=()) -> str:
    folder = store.private_folder()
    write_points(folder / "points.safetensors", scene.points)
    frames = [
        write_view(folder, n, im, c, mask=m if i in masked else None)
        for i, (n, im, c, m) in enumerate(
            zip(scene.names, scene.images, scene.cameras, scene.object_masks, strict=True)
        )
    ]
    count = len(frames)
    metadata = PosedCapture(
        frames=tuple(frames),
        ordered=True,
        lens=LensModel(model="PINHOLE", params=(1.0, 1.0, 0.0, 0.0), evidence="exact"),
        registration=Registration(
            source="known", given=count, registered=count, mean_reprojection_error_px=0.0,
            points=len(scene.points), median_triangulation_angle_deg=20.0,
        ),
        source_from_normalised_scale=1.0,
        source_from_normalised=IDENTITY,
        centre_depth=0.85,
        up_evidence="exact",
    )  # fmt: skip
    return store.put(folder, "posed-capture", metadata)


def field(store: Store, scene: SyntheticScene, noise: float = 0.0, opaque: float = 1.0) -> str:
    """A field artifact at half the pictures' size with smooth relative depth noise."""
    folder, rng, views = store.private_folder(), np.random.default_rng(0), []
    for name, depth, image in zip(scene.names, scene.depths, scene.images, strict=True):
        half = depth[::2, ::2]
        bumps = cv2.GaussianBlur(rng.normal(size=half.shape), (0, 0), 3)
        half = half * (1 + noise * bumps / bumps.std())
        write_exr(folder / f"views/{name}.exr", {"depth.Z": half, "median.Z": half, "opacity.A": 0 * half + opaque})
        write_png(folder / f"views/{name}.png", image)
        views.append(FieldView(name=name, maps=f"views/{name}.exr", picture=f"views/{name}.png"))
    (folder / "weights.safetensors").write_bytes(b"not read here")
    (folder / "learning_curve.csv").write_text("step\n")
    metadata = RadianceFieldArtifact(
        label="pretrained", spec=FieldSpec(), views=tuple(views), steps=1, seed=0, backend="exact"
    )
    return store.put(folder, "radiance-field", metadata)


def make_bench(folder: Path, *, views: int = 8, width: int = 160, height: int = 120) -> Bench:
    """Views over 160 degrees, depth 2 % off in bumps."""
    store = FolderStore(folder)
    scene = synthetic_scene(views=views, width=width, height=height, arc_deg=160)
    return Bench(store, scene, {"posed-capture": capture(store, scene), "radiance-field": field(store, scene, 0.02)})


def put_truth(store: Store, cameras) -> str:
    """Truth views of another size; their pictures must not be looked at, so that they are unreadable."""
    folder, frames = store.private_folder(), []
    for i, camera in enumerate(cameras):
        frame = write_view(folder, f"truth_{i}", np.zeros((camera.height, camera.width, 3)), camera)
        (folder / frame.path).write_bytes(b"no picture")
        frames.append(frame)
    metadata = PosedTruth(frames=tuple(frames), registered_share=1.0, mean_reprojection_error_px=0.1)
    return store.put(folder, "posed-truth", metadata)


def middle_of_ball(scene: SyntheticScene, view: int) -> list[float]:
    return [float(v) for v in scene.cameras[view].project(np.zeros(3))[0]]


def recall(masks, truth) -> np.ndarray:
    return np.array([(m & t).sum() / t.sum() for m, t in zip(masks, truth, strict=True)])


def precision(masks, truth) -> np.ndarray:
    return np.array([(m & t).sum() / m.sum() for m, t in zip(masks, truth, strict=True)])
