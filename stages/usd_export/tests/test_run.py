"""The whole stage on the synthetic room, whose fields store views of exact depth: real artifacts, store and shim."""

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from safetensors.numpy import save_file

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import (
    CompletedView,
    CompletedViews,
    FieldSpec,
    GridSpec,
    LensModel,
    MaskSet,
    MaskView,
    MetricScale,
    PosedCapture,
    Primitive,
    RadianceFieldArtifact,
    Registration,
    UsdScene,
)
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.radiance.artifact import stub_weights, write_curve
from inpaint3d.radiance.artifact import write_view as radiance_view
from inpaint3d.scene.capture_io import write_points, write_view
from inpaint3d.scene.image_io import write_mask, write_png
from inpaint3d.scene.map_io import write_codes
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene

TINY = {"render_longest_side": 24, "grid": 64, "texture_size": 256, "triangles": 4000}
HELD_OUT = ("view_003",)
SPEC = FieldSpec(
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(4,),
    grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=2),
    samples=4,
    density_width=8,
    bottleneck=4,
    view_width=8,
    view_layers=1,
    far=3.0,
)


def posed(store: Store, scene: SyntheticScene) -> str:
    folder = store.private_folder()
    views = zip(scene.names, scene.images, scene.cameras, strict=True)
    frames = tuple(
        write_view(folder, name, image, camera, split="test" if name in HELD_OUT else "train")
        for name, image, camera in views
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


def masks(store: Store, scene: SyntheticScene, *, missing: int = 0, primitives: tuple[Primitive, ...] = ()) -> str:
    folder = store.private_folder()
    views = []
    for name, mask in list(zip(scene.names, scene.object_masks, strict=True))[missing:]:
        write_mask(folder / "masks" / f"{name}.png", mask)
        views.append(MaskView(name=name, mask=f"masks/{name}.png", share=float(mask.mean())))
    metadata = MaskSet(
        kind="per-view", task="inpaint", origin="imported", method="exact", views=tuple(views), primitives=primitives
    )
    return store.put(folder, "mask-set", metadata)


def completed(store: Store, scene: SyntheticScene) -> str:
    folder = store.private_folder()
    views = []
    for name, image in zip(scene.names, scene.empty_images, strict=True):
        if name not in HELD_OUT:
            write_png(folder / "pictures" / f"{name}.png", image)
            write_codes(folder / "sources" / f"{name}.png", np.zeros(image.shape[:2], np.uint16))
            views.append(CompletedView(name=name, picture=f"pictures/{name}.png", sources=f"sources/{name}.png"))
    return store.put(folder, "completed-views", CompletedViews(method="classical", summary="exact", views=tuple(views)))


def field(store: Store, scene: SyntheticScene | None, *, ball: bool = False, opacity: float = 1.0) -> str:
    """A field that stores exact views of the room, or none: then they are rendered from its untrained weights."""
    folder = store.private_folder()
    save_file(stub_weights(SPEC), folder / "weights.safetensors")
    write_curve(folder, [])
    views = []
    for i, name in enumerate(scene.names if scene else ()):
        depth = (scene.depths if ball else scene.empty_depths)[i].astype(np.float32)
        picture = (scene.images if ball else scene.empty_images)[i]
        maps = {"rgb": picture, "depth": depth, "median_depth": depth, "opacity": np.full_like(depth, opacity)}
        views.append(radiance_view(folder, name, scene.cameras[i], maps))
    metadata = RadianceFieldArtifact(
        label="joint-sds", spec=SPEC, views=tuple(views), steps=1, seed=0, backend="reference"
    )
    return store.put(folder, "radiance-field", metadata)


def exported(store: Store, inputs: dict, **parameters) -> tuple[Path, UsdScene]:
    invocation = Invocation(parameters=TINY | parameters, inputs=inputs, threads=1)
    record = execute("inpaint3d.stages.usd_export", store, invocation, io.StringIO())
    artifact = store.open(record.outputs["usd-scene"], UsdScene)
    return artifact.root, artifact.metadata


def surface(root: Path, variant: str) -> np.ndarray:
    stage = Usd.Stage.Open(str(root / "scene.usdz"))
    stage.GetDefaultPrim().GetVariantSet("content").SetVariantSelection(variant)
    return np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Surface")).GetPointsAttr().Get())


@pytest.fixture(scope="module")
def scene() -> SyntheticScene:
    return synthetic_scene()


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Store:
    return FolderStore(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def inputs(store, scene) -> dict:
    return {
        "inpainted": field(store, scene),
        "original": field(store, scene, ball=True),
        "posed-capture": posed(store, scene),
        "mask-set": masks(store, scene),
        "completed-views": completed(store, scene),
    }


@pytest.fixture(scope="module")
def full(store, inputs) -> tuple[Path, UsdScene]:
    return exported(store, inputs)


def test_the_ball_is_in_the_original_and_gone_from_the_inpainted(full):
    root, _ = full

    def on_the_ball(points: np.ndarray) -> int:
        above_the_floor = points[:, 2] > -0.05
        return int((above_the_floor & (np.abs(np.linalg.norm(points, axis=1) - 0.2) < 0.06)).sum())

    assert on_the_ball(surface(root, "original")) > 20
    assert on_the_ball(surface(root, "inpainted")) == 0


def test_the_floor_is_flat_where_it_is(full):
    points = surface(full[0], "inpainted")
    near = points[np.abs(points[:, :2]).max(1) < 0.3]
    # a cell is 0.05 wide
    assert np.median(np.abs(near[:, 2] + 0.2)) < 0.02


def test_a_held_out_photo_is_nearly_what_the_mesh_shows(full, scene):
    found = full[1].fidelity
    assert found is not None
    assert found.photos == 1
    index = scene.names.index(HELD_OUT[0])
    known = scene.images[index][~scene.object_masks[index]]
    flat = -10 * np.log10(known.var(0).mean())
    # the walls' finest detail is half as wide as a pixel of these photos: no two show the same of it
    assert found.psnr > flat + 4
    assert 0 < found.ssim < 1


def test_most_of_the_texture_is_used(full):
    assert full[1].texel_use > 0.4
    assert 1 <= full[1].charts < full[1].triangles / 10


def test_without_completed_views_the_field_paints_the_hole(store, full, inputs):
    bare = {port: digest for port, digest in inputs.items() if port != "completed-views"}
    _, scene = exported(store, bare, original=False)
    assert scene.fidelity is not None
    assert scene.fidelity.psnr == pytest.approx(full[1].fidelity.psnr, abs=0.5)


def test_two_runs_give_the_same_package(store, full, inputs, tmp_path):
    other = FolderStore(tmp_path / "other")
    for digest in inputs.values():
        source = store.root / "objects" / digest.removeprefix("sha256:")
        shutil.copytree(source, other.root / "objects" / source.name)
    root, scene = exported(other, inputs)
    assert (root / scene.package).read_bytes() == (full[0] / full[1].package).read_bytes()


def test_metadata_tells_what_is_in_the_files(full):
    root, scene = full
    assert scene.variants == ("inpainted", "original")
    assert (scene.cameras, scene.validation_errors) == (8, 0)
    assert json.loads((root / "validation.json").read_text())["findings"] == []
    stage = Usd.Stage.Open(str(root / scene.package))
    counts = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Surface")).GetFaceVertexCountsAttr().Get()
    assert len(counts) == scene.triangles
    assert stage.GetPrimAtPath("/Scene/Mask/Hull")
    assert {str(p.relative_to(root)) for p in (root / "textures").iterdir()} == set(scene.textures)


def test_a_mask_with_primitives_is_drawn_as_such(store, scene, inputs):
    ball = Primitive(kind="sphere", centre=(0, 0, 0), size=(0.4, 0.4, 0.4))
    root, metadata = exported(store, inputs | {"mask-set": masks(store, scene, primitives=(ball,))}, original=False)
    stage = Usd.Stage.Open(str(root / "scene.usdc"))
    assert stage.GetPrimAtPath("/Scene/Mask/Volume_0").IsA(UsdGeom.Sphere)
    assert not stage.GetPrimAtPath("/Scene/Mask/Hull")
    assert metadata.variants == ("inpainted",)


@pytest.mark.parametrize(("told", "asked", "expected"), [(0.3, None, 0.3), (None, None, None), (0.3, 0.7, 0.7)])
def test_the_scale_is_that_of_the_posed_capture_unless_a_person_says_other(store, inputs, told, asked, expected):
    posed = store.open(inputs["posed-capture"], PosedCapture)
    scale = None if told is None else MetricScale(metres_per_unit=told, uncertainty=0.01, evidence="a marker")
    folder = store.private_folder()
    shutil.copytree(posed.root, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("artifact.json"))
    known = store.put(folder, "posed-capture", posed.metadata.model_copy(update={"scale": scale}))
    chosen = {} if asked is None else {"metres_per_unit": asked}
    _, metadata = exported(store, inputs | {"posed-capture": known}, original=False, **chosen)
    assert metadata.metres_per_unit == expected


def test_views_that_the_field_does_not_store_are_rendered(store, inputs):
    fog = inputs | {"inpainted": field(store, None)}
    _, metadata = exported(store, fog, original=False, opaque=0.0, smallest_piece=0.0, views=3)
    assert metadata.triangles > 0
    assert metadata.validation_errors == 0


def test_a_field_without_a_surface_is_bad_input(store, scene, inputs):
    fog = inputs | {"inpainted": field(store, scene, opacity=0.1)}
    with pytest.raises(BadInputError, match="shows no surface"):
        exported(store, fog)


def test_a_view_without_a_mask_is_bad_input(store, scene, inputs):
    with pytest.raises(BadInputError, match="no mask for view view_000"):
        exported(store, inputs | {"mask-set": masks(store, scene, missing=1)})


def test_the_stub_is_a_valid_scene(store, inputs):
    record = execute(
        "inpaint3d.stages.usd_export", store, Invocation(inputs=inputs, threads=1, stub=True), io.StringIO()
    )
    assert store.open(record.outputs["usd-scene"], UsdScene).metadata.validation_errors == 0
