"""The stage on artifacts: its methods, what it writes, what it refuses, and that nothing under a mask is looked at."""

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import (
    CompletedViews,
    FieldSpec,
    GridSpec,
    PaintedView,
    PaintedViews,
    RadianceFieldArtifact,
)
from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO, SOURCE_CODES
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.radiance.artifact import stub_weights, write_curve, write_view
from inpaint3d.scene.image_io import read_image, write_mask, write_png
from inpaint3d.scene.map_io import read_codes, read_exr
from inpaint3d.scene.synthetic import SyntheticScene
from tests.room_artifacts import put_masks, put_plan, put_posed, put_prior

MODULE = "inpaint3d.stages.view_completion"
GRID = GridSpec(levels=1, coarsest=4, finest=4, log2_table=6, channels=1)
SPEC = FieldSpec(
    grid=GRID, proposal_grid=GRID, proposal_samples=(2,), samples=2, density_width=4, bottleneck=3, view_layers=0
)
METHODS = ["photo-completion", "classical", {"name": "prior-samples", "sample_steps": 2}]


def put_field(store: Store, room: SyntheticScene) -> Digest:
    """A field whose renders are the empty room's."""
    folder = store.private_folder()
    save_file(stub_weights(SPEC), folder / "weights.safetensors")
    write_curve(folder, [[1, 1, 0.5, 20.0]])
    views = [
        write_view(folder, n, c, {"rgb": i, "depth": d, "median_depth": d, "opacity": np.ones_like(d)})
        for n, c, i, d in zip(room.names, room.cameras, room.empty_images, room.empty_depths, strict=True)
    ]
    metadata = RadianceFieldArtifact(label="masked", spec=SPEC, views=tuple(views), steps=1, seed=0, backend="test")
    return store.put(folder, "radiance-field", metadata)


def put_painting(store: Store, name: str, picture: np.ndarray, mask: np.ndarray) -> Digest:
    folder = store.private_folder()
    write_png(folder / "pictures" / "a.png", picture)
    write_mask(folder / "masks" / "a.png", mask)
    view = PaintedView(name=name, picture="pictures/a.png", mask="masks/a.png")
    return store.put(folder, "painted-views", PaintedViews(views=(view,)))


@pytest.fixture
def inputs(store: Store, room: SyntheticScene) -> Callable[..., dict[str, Any]]:
    def make(images: np.ndarray | None = None) -> dict[str, Any]:
        return {
            "posed-capture": put_posed(store, room, room.images if images is None else images),
            "effect-plan": put_plan(store),
            "mask-set": put_masks(store, room.names, room.object_masks),
            "radiance-field": put_field(store, room),
            "diffusion-prior": put_prior(store),
        }

    return make


def complete(store: Store, inputs: dict[str, Any], method: Any = "photo-completion") -> Artifact[CompletedViews]:
    invocation = Invocation(inputs=inputs, parameters={"method": method}, threads=1)
    record = execute(MODULE, store, invocation, io.StringIO())
    return store.open(record.outputs["completed-views"], CompletedViews)


@pytest.mark.parametrize("method", METHODS)
def test_known_pixels_are_the_photo_s_and_sources_say_what_was_filled(
    store: Store, room: SyntheticScene, inputs: Callable[..., dict[str, Any]], method: Any
) -> None:
    result = complete(store, inputs(), method)
    assert result.metadata.method == (method if isinstance(method, str) else method["name"])
    by_name = dict(zip(room.names, zip(room.images, room.object_masks, strict=True), strict=True))
    assert [v.name for v in result.metadata.views] == [n for i, n in enumerate(room.names) if i != 2], "training views"
    for view in result.metadata.views:
        image, mask = by_name[view.name]
        picture, sources = read_image(result.path(view.picture)), read_codes(result.path(view.sources))
        np.testing.assert_allclose(picture[~mask], image[~mask], atol=0.6 / 255)
        assert not (sources[~mask]).any()
        assert sources[mask].any()
        assert sum(view.shares.values()) == pytest.approx(1, abs=1e-4)


def test_photo_completion_writes_surfaces_and_what_came_from_where(
    store: Store, room: SyntheticScene, inputs: Callable[..., dict[str, Any]]
) -> None:
    result = complete(store, inputs())
    first = result.metadata.views[0]
    sources = read_codes(result.path(first.sources))
    assert (sources[room.object_masks[0]] > 0).all()
    assert first.shares["photos"] == pytest.approx((sources >= FIRST_PHOTO).sum() / (sources > 0).sum(), abs=1e-5)
    assert first.depth is not None
    depth, hole = read_exr(result.path(first.depth))["depth.Z"], room.object_masks[0]
    assert np.median(np.abs(depth / room.empty_depths[0] - 1)[hole]) < 0.05
    assert set(result.metadata.reference_views) <= set(room.names)
    assert "as other photos show it" in result.metadata.summary


@pytest.mark.parametrize("method", METHODS)
def test_all_that_is_masked_is_filled_also_where_less_is_to_be_fitted(
    store: Store, room: SyntheticScene, inputs: Callable[..., dict[str, Any]], method: Any
) -> None:
    half = room.object_masks & (np.arange(room.object_masks.shape[2]) < room.object_masks.shape[2] // 2)
    less = put_masks(store, room.names, room.object_masks, half)
    assert complete(store, inputs() | {"mask-set": less}, method).digest == complete(store, inputs(), method).digest


@pytest.mark.parametrize("method", METHODS)
def test_nothing_under_the_mask_is_looked_at(
    store: Store, room: SyntheticScene, inputs: Callable[..., dict[str, Any]], method: Any
) -> None:
    """Repainting every masked pixel changes no byte; repainting the others does."""
    marked = np.where(room.object_masks[..., None], np.array([1.0, 0.0, 1.0], np.float32), room.images)
    other = np.where(room.object_masks[..., None], room.images, 1 - room.images)
    clean = complete(store, inputs(), method)
    assert complete(store, inputs(marked), method).digest == clean.digest
    assert complete(store, inputs(other), method).digest != clean.digest


def test_a_painted_view_is_taken(store: Store, room: SyntheticScene, inputs: Callable[..., dict[str, Any]]) -> None:
    painted = np.broadcast_to(np.array([1.0, 0.0, 1.0], np.float32), room.images[0].shape)
    mask = room.object_masks[0]
    wired = inputs() | {"painted-views": put_painting(store, room.names[0], painted, mask)}
    result = complete(store, wired)
    view = result.metadata.views[0]
    np.testing.assert_allclose(read_image(result.path(view.picture))[mask], painted[mask], atol=1 / 255)
    assert (read_codes(result.path(view.sources))[mask] == SOURCE_CODES["painted"]).all()
    assert any(v.shares.get("painted", 0) > 0.2 for v in result.metadata.views[1:])


def test_a_painted_view_of_another_capture_or_size_is_bad_input(
    store: Store, room: SyntheticScene, inputs: Callable[..., dict[str, Any]]
) -> None:
    small = np.zeros((10, 12, 3), np.float32)
    unknown = put_painting(store, "elsewhere", room.images[0], room.object_masks[0])
    with pytest.raises(BadInputError, match=r"elsewhere is no training view of this capture; there are view_000"):
        complete(store, inputs() | {"painted-views": unknown})
    with pytest.raises(BadInputError, match=r"view_000 is 12x10 but the view is 48x36"):
        complete(store, inputs() | {"painted-views": put_painting(store, "view_000", small, small[..., 0] > 0)})


def test_a_method_that_asks_a_prior_needs_one(store: Store, inputs: Callable[..., dict[str, Any]]) -> None:
    wired = inputs()
    del wired["diffusion-prior"]
    with pytest.raises(ConfigurationError, match=r"'prior-samples' asks a prior, and nothing is wired"):
        complete(store, wired, "prior-samples")
