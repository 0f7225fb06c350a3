"""The whole stage on the synthetic room, with tiny fields of known quality: real artifacts, real store, real shim."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import (
    Evaluation,
    FieldSpec,
    GridSpec,
    LensModel,
    MaskSet,
    MaskView,
    PosedCapture,
    PosedTruth,
    RadianceFieldArtifact,
    Registration,
)
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.radiance.io import save_field
from inpaint3d.scene.capture_io import write_points, write_view
from inpaint3d.scene.image_io import read_image, write_mask
from inpaint3d.scene.masked_views import load_masked_scene
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene

MODELS = {"posed-capture": PosedCapture, "mask-set": MaskSet}
TINY = {
    "render_longest_side": 24,
    "truth_views": 3,
    "held_out_views": 1,
    "picture_views": 1,
    "contact_longest_side": 24,
}
SPEC = FieldSpec(
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(4,),
    grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=2),
    samples=4,
    density_width=8,
    bottleneck=4,
    view_width=8,
    view_layers=1,
    far=10.0,
)


def posed(store: Store, scene: SyntheticScene) -> str:
    folder = store.private_folder()
    frames = tuple(
        write_view(folder, name, image, camera, split="test" if i == 2 else "train")
        for i, (name, image, camera) in enumerate(zip(scene.names, scene.images, scene.cameras, strict=True))
    )
    write_points(folder / "points.safetensors", scene.points)
    registration = Registration(
        source="known", given=8, registered=8, mean_reprojection_error_px=0, points=9, median_triangulation_angle_deg=9
    )
    metadata = PosedCapture(
        frames=frames, ordered=True, lens=LensModel(model="PINHOLE", params=(), evidence="exact"),
        registration=registration, source_from_normalised_scale=1, up_evidence="exact", centre_depth=0.85,
        source_from_normalised=((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0)),
    )  # fmt: skip
    return store.put(folder, "posed-capture", metadata)


def truth(store: Store, scene: SyntheticScene) -> str:
    folder = store.private_folder()
    views = zip(scene.names[::2], scene.empty_images[::2], scene.cameras[::2], strict=True)
    frames = tuple(write_view(folder, f"truth_{name}", image, camera) for name, image, camera in views)
    return store.put(folder, "posed-truth", PosedTruth(frames=frames, registered_share=1, mean_reprojection_error_px=0))


def masks(store: Store, scene: SyntheticScene, *, missing: int = 0) -> str:
    folder = store.private_folder()

    def write(name: str, mask: np.ndarray, under: str) -> MaskView:
        write_mask(folder / under / f"{name}.png", mask)
        return MaskView(name=name, mask=f"{under}/{name}.png", share=float(mask.mean()))

    pairs = list(zip(scene.names, scene.object_masks, strict=True))
    views = [write(name, mask, "masks") for name, mask in pairs[missing:]]
    hidden = [write(f"truth_{name}", mask, "truth_masks") for name, mask in pairs[::2]]
    # a truth view that the mask does not reach is skipped
    write_mask(folder / "truth_masks" / "truth_view_002.png", np.zeros_like(scene.object_masks[0]))
    metadata = MaskSet(
        kind="per-view",
        task="inpaint",
        origin="imported",
        method="exact",
        views=tuple(views),
        truth_views=tuple(hidden),
    )
    return store.put(folder, "mask-set", metadata)


def field(store: Store, label: str, *, seed: int = 0, poison: bool = False) -> str:
    folder = store.private_folder()
    model = RadianceField(SPEC, seed=seed)
    if poison:
        with torch.no_grad():
            # Finite, as all is that can be saved; sums of such numbers are not.
            for parameter in model.parameters():
                parameter.fill_(3e38).view(-1)[::2] *= -1
    save_field(folder / "weights.safetensors", model)
    (folder / "learning_curve.csv").write_text("step,rays,loss,psnr\n10,100,0.5,9.0\n20,200,0.4,\n40,400,0.3,12.5\n")
    metadata = RadianceFieldArtifact(label=label, spec=SPEC, views=(), steps=40, seed=seed, backend="reference")
    return store.put(folder, "radiance-field", metadata)


def evaluated(store: Store, inputs: dict, **parameters) -> tuple[Path, Evaluation]:
    invocation = Invocation(parameters=TINY | parameters, inputs=inputs, threads=1)
    record = execute("inpaint3d.stages.evaluation", store, invocation, io.StringIO())
    artifact = store.open(record.outputs["evaluation"], Evaluation)
    return artifact.root, artifact.metadata


@pytest.fixture(scope="module")
def scene() -> SyntheticScene:
    return synthetic_scene()


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Store:
    return FolderStore(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def inputs(store, scene) -> dict:
    return {"posed-capture": posed(store, scene), "mask-set": masks(store, scene)}


@pytest.fixture(scope="module")
def full(store, scene, inputs) -> tuple[Path, Evaluation]:
    fields = [field(store, "joint-sds"), field(store, "joint-sds")]
    return evaluated(store, inputs | {"radiance-fields": fields, "posed-truth": truth(store, scene)})


def test_every_protocol_has_every_method(full):
    methods = {p.name: {m.method for m in p.metrics} for p in full[1].protocols}
    fields = {"joint-sds", "joint-sds #2"}
    assert methods == {
        "bbox10-vgg": fields | {"mean-surround"},
        "masked-pixels": fields | {"mean-surround"},
        "held-out-known-pixels": fields | {"mean-colour", "nearest-photo-warped"},
        "full": fields,
        "held-out-samples": fields,
        "hole-statistics": fields,
        "neighbouring-views": fields,
        "sparse-points": fields,
    }


def test_a_truth_view_with_an_empty_mask_is_skipped_and_n_is_stated(full):
    box = next(p for p in full[1].protocols if p.name == "bbox10-vgg")
    assert {m.views for m in box.metrics} == {3}
    assert {m.name for m in box.metrics} == {"psnr", "ssim", "lpips_vgg", "lpips_alex", "fd_lite0", "kid_lite0"}
    assert "3 against 3 crops" in box.description


def test_the_figure_of_the_learning_curves_has_its_own_name(store, inputs, full):
    capture, masks = (store.open(inputs[port], model) for port, model in MODELS.items())
    photos = [KnownPhoto(v.camera, v.image, v.known) for v in load_masked_scene(capture, masks).test]
    curve = HeldOut.at_random(photos, 1024, "cpu").psnr(RadianceField(SPEC, seed=0).eval(), 8192)
    samples = next(p for p in full[1].protocols if p.name == "held-out-samples")
    assert [m.value for m in samples.metrics] == pytest.approx([curve, curve], abs=1e-5)


def test_every_protocol_of_pictures_states_its_conditions(full):
    of_pictures = {"bbox10-vgg", "masked-pixels", "full", "held-out-known-pixels", "held-out-samples"}
    for protocol in full[1].protocols:
        if protocol.name in of_pictures:
            assert all((protocol.crop, protocol.resolution, protocol.colour_range)), protocol.name
            assert {m.views for m in protocol.metrics if m.name == "psnr"} == {protocol.views}


def test_crops_of_another_growth_have_another_name(store, scene, inputs):
    wired = inputs | {"radiance-fields": [field(store, "a")], "posed-truth": truth(store, scene)}
    names = [
        evaluated(store, wired, perceptual=False, **parameters)[1].protocols[0].name
        for parameters in ({"box_growth": 0.25}, {"box_protocol": "spin-nerf", "render_longest_side": 1008})
    ]
    assert names == ["bbox25-vgg", "spin-nerf"]


def test_equal_fields_have_equal_figures(full):
    values = {(p.name, m.method, m.name): m.value for p in full[1].protocols for m in p.metrics}
    one, two = (
        {(protocol, name): value for (protocol, of, name), value in values.items() if of == method}
        for method in ("joint-sds", "joint-sds #2")
    )
    assert {name for _, name in one} > {"psnr", "lpips_vgg", "opacity_mean"}
    assert one == two


def test_seeds_of_one_method_are_named_and_each_two_compared(store, inputs):
    fields = [field(store, "joint-reference", seed=seed) for seed in (0, 5, 9)]
    _, metadata = evaluated(store, inputs | {"radiance-fields": [*fields, field(store, "masked", seed=1)]})
    between = next(p for p in metadata.protocols if p.name == "between-seeds")
    seeds = [f"joint-reference, seed {seed}" for seed in (0, 5, 9)]
    pairs = [f"{seeds[i]} | {seeds[k]}" for i, k in ((0, 1), (0, 2), (1, 2))]
    for name in ("lpips_between", "colour_between"):
        values = {m.method: m.value for m in between.metrics if m.name == name}
        assert set(values) == {*pairs, "all pairs"}
        assert all(values[pair] > 0 for pair in pairs)
        assert values["all pairs"] == pytest.approx(np.mean([values[pair] for pair in pairs]), abs=2e-6)
    assert {m.method for p in metadata.protocols if p.name == "hole-statistics" for m in p.metrics} == {
        *seeds,
        "masked",
    }


def test_a_photo_warped_by_sparse_depth_beats_the_mean_colour(full):
    held = next(p for p in full[1].protocols if p.name == "held-out-known-pixels")
    psnr = {m.method: m.value for m in held.metrics if m.name == "psnr"}
    assert psnr["nearest-photo-warped"] > psnr["mean-colour"]


def test_the_table_holds_every_view(full):
    root, _ = full
    with (root / "per_view.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    box = [r for r in rows if r["protocol"] == "bbox10-vgg" and r["metric"] == "psnr"]
    assert {r["view"] for r in box} == {"truth_view_000", "truth_view_004", "truth_view_006"}
    assert all(np.isfinite(float(r["value"])) for r in rows)


def test_pictures_are_there_in_panels_of_one_width(full):
    root, evaluation = full
    assert "pictures/before_mask_after_depth.png" in evaluation.pictures
    assert {p.name for p in (root / "pictures").iterdir()} == {Path(p).name for p in evaluation.pictures}
    assert evaluation.contact.captions[0] == "before"
    for strip in (evaluation.contact, *evaluation.strips):
        width = read_image(root / strip.file).shape[1]
        assert (width + strip.gap) % len(strip.captions) == 0  # panels of one width


def test_without_truth_it_says_so(store, inputs):
    _, evaluation = evaluated(store, inputs | {"radiance-fields": [field(store, "a")]}, perceptual=False)
    names = ["held-out-known-pixels", "held-out-samples", "hole-statistics", "neighbouring-views", "sparse-points"]
    assert [p.name for p in evaluation.protocols] == names
    assert any("nothing here says whether the filling is true" in weakness for weakness in evaluation.weaknesses)


def test_a_field_that_renders_nan_is_counted_and_never_averaged(store, inputs):
    fields = [field(store, "good"), field(store, "bad", poison=True)]
    _, evaluation = evaluated(store, inputs | {"radiance-fields": fields}, perceptual=False)
    assert evaluation.protocols == ()
    assert set(evaluation.non_finite) == {"bad/view_002", "bad/held-out-samples", "bad/sparse-points"}
    assert evaluation.non_finite["bad/view_002"] >= 24 * 18


def test_a_photo_without_a_mask_is_bad_input(store, scene, inputs):
    broken = inputs | {"mask-set": masks(store, scene, missing=1), "radiance-fields": [field(store, "a")]}
    with pytest.raises(BadInputError, match=r"view_000 \(1 in all\)"):
        evaluated(store, broken)


def test_no_field_is_bad_input(store, inputs):
    with pytest.raises(BadInputError, match="at least one"):
        evaluated(store, inputs)


def test_the_stub_is_a_valid_evaluation(store, inputs):
    invocation = Invocation(inputs=inputs | {"radiance-fields": [field(store, "a")]}, threads=1, stub=True)
    events = io.StringIO()
    record = execute("inpaint3d.stages.evaluation", store, invocation, events)
    stub = store.open(record.outputs["evaluation"], Evaluation)
    assert stub.metadata.protocols[0].metrics
    assert [json.loads(line)["event"] for line in events.getvalue().splitlines()] == ["progress"]
