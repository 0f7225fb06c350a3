"""The synthetic room as artifacts in a store: a posed capture with masks, a plan, an untrained prior."""

import numpy as np

from inpaint3d.contracts.models.artifacts import (
    DiffusionPrior,
    Effect,
    EffectPlan,
    LensModel,
    MaskSet,
    MaskView,
    PosedCapture,
    PriorSpec,
    Registration,
)
from inpaint3d.contracts.models.artifacts.completion import SOURCE_CODES
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.store import Store
from inpaint3d.diffusion.io import save_prior
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.scene.capture_io import write_points, write_view
from inpaint3d.scene.image_io import write_mask
from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.stages.view_completion.completion import Completion, write_completions

PRIOR = PriorSpec(size=16, width=8, multipliers=(1, 2), blocks=(1, 1), attention=(False, False))


def put_posed(
    store: Store,
    room: SyntheticScene,
    images: np.ndarray,
    lens: tuple[float, float, float, float] = (40.0, 40.0, 24.0, 18.0),
) -> Digest:
    """lens: fx, fy, cx, cy at the size of the photos, where somebody looks at those."""
    folder = store.private_folder()
    frames = [
        write_view(folder, name, image, camera, split="test" if i == 2 else "train")
        for i, (name, image, camera) in enumerate(zip(room.names, images, room.cameras, strict=True))
    ]
    write_points(folder / "points.safetensors", room.points)
    metadata = PosedCapture(
        frames=tuple(frames),
        ordered=True,
        lens=LensModel(model="PINHOLE", params=lens, evidence="synthetic"),
        registration=Registration(
            source="known",
            given=len(frames),
            registered=len(frames),
            mean_reprojection_error_px=0.0,
            points=len(room.points),
            median_triangulation_angle_deg=20.0,
        ),
        source_from_normalised_scale=1.0,
        source_from_normalised=((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0)),
        centre_depth=0.85,
        up_evidence="synthetic",
    )
    return store.put(folder, "posed-capture", metadata)


def put_masks(store: Store, names: list[str], masks: np.ndarray, unseen: np.ndarray | None = None) -> Digest:
    """unseen: of the masks, what is to be filled alone."""
    folder = store.private_folder()
    views = []
    for i, (name, mask) in enumerate(zip(names, masks, strict=True)):
        write_mask(folder / "masks" / f"{name}.png", mask)
        view = MaskView(name=name, mask=f"masks/{name}.png", share=float(mask.mean()))
        if unseen is not None:
            write_mask(folder / "unseen" / f"{name}.png", unseen[i])
            view = view.model_copy(update={"unseen": f"unseen/{name}.png"})
        views.append(view)
    metadata = MaskSet(
        kind="per-view",
        task="inpaint",
        origin="imported",
        method="synthetic",
        views=tuple(views),
        hole="object" if unseen is None else "unseen",
    )
    return store.put(folder, "mask-set", metadata)


def put_plan(store: Store, *active: str) -> Digest:
    names = ("contraction", "lens-distortion", "exposure", "view-dependence")
    effects = [Effect(name=n, state="on" if n in active else "off", evidence={}, reason="a test") for n in names]
    return store.put(store.private_folder(), "effect-plan", EffectPlan(effects=tuple(effects)))


def put_prior(store: Store, spec: PriorSpec = PRIOR) -> Digest:
    folder = store.private_folder()
    save_prior(folder / "weights.safetensors", InpaintingPrior(spec, seed=0))
    (folder / "training_curve.csv").write_text("step,loss,held_out_loss\n")
    return store.put(folder, "diffusion-prior", DiffusionPrior(spec=spec, steps=0, seed=0, trained_on="nothing"))


def put_completed(
    store: Store,
    room: SyntheticScene,
    *,
    method: str = "photo-completion",
    skip: int = 0,
    pictures: np.ndarray | None = None,
    code: int = SOURCE_CODES["example"],
    depth: bool = True,
) -> Digest:
    """Completed views that show the empty room, or `pictures`; the first `skip` views are missing. code: where all that
    is filled came from.
    """
    folder = store.private_folder()
    views = [
        Completion(
            name, image, np.where(hole, code, 0).astype(np.uint16), surface.astype(np.float32) if depth else None
        )
        for name, image, hole, surface in zip(
            room.names,
            room.empty_images if pictures is None else pictures,
            room.object_masks,
            room.empty_depths,
            strict=True,
        )
    ]
    metadata = write_completions(folder, views[skip:], method=method, summary="the empty room")
    return store.put(folder, "completed-views", metadata)
