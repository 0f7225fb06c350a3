"""The stage on artifacts: what it writes, and that photos of every kind keep what they are."""

import io
import json
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import CleanPlates, PaintedView, PaintedViews
from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO, SOURCE_CODES
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.scene.colour import to_bytes
from inpaint3d.scene.image_io import read_image, read_mask, write_mask, write_png
from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.stages.plate_export.photo_files import read_photo
from tests.room_artifacts import put_completed

MODULE = "inpaint3d.stages.plate_export"
Make = Callable[..., dict[str, Any]]


def export(store: Store, inputs: dict[str, Any], **parameters: Any) -> Artifact[CleanPlates]:
    invocation = Invocation(inputs=inputs, parameters={"grain": False, **parameters}, threads=1)
    record = execute(MODULE, store, invocation, io.StringIO())
    return store.open(record.outputs["clean-plates"], CleanPlates)


def test_known_pixels_are_the_photo_s_and_the_hole_is_as_sharp_as_photos(
    store: Store, room: SyntheticScene, photos: SyntheticScene, inputs: Make
) -> None:
    """What other photos show comes from those, not from the posed views, a quarter as wide."""
    plates = export(store, inputs(code=FIRST_PHOTO))
    apart: list[float] = []
    enlarged: list[float] = []
    for i, record in enumerate(plates.metadata.plates):
        picture, mask = read_image(plates.path(record.picture)), read_mask(plates.path(record.mask))
        np.testing.assert_array_equal(to_bytes(picture)[~mask], to_bytes(photos.images[i])[~mask])
        assert mask[photos.object_masks[i]].mean() > 0.95
        truth = photos.empty_images[i]
        coarse = cv2.resize(room.empty_images[i], truth.shape[1::-1], interpolation=cv2.INTER_CUBIC)
        apart.append(float(np.abs(picture - truth)[mask].mean()))
        enlarged.append(float(np.abs(coarse - truth)[mask].mean()))
    assert np.mean(apart) < 0.7 * np.mean(enlarged)


@pytest.mark.parametrize(
    ("suffix", "kind", "dtype", "factor"),
    [(".tif", "uint16", np.uint16, 1.0), (".exr", "half", np.float16, 6.0), (".tif", "float", np.float32, 6.0)],
)
def test_plates_keep_their_photo_s_bits_and_range(
    store: Store, photos: SyntheticScene, inputs: Make, suffix: str, kind: str, dtype: type, factor: float
) -> None:
    wired = inputs(photos.images * np.float32(factor), suffix, kind)
    plates = export(store, wired)
    for record in plates.metadata.plates:
        codes, _ = read_photo(plates.path(record.picture))
        given, _ = read_photo(store.fetch(wired["capture"]) / f"originals/{record.name}{suffix}")
        mask = read_mask(plates.path(record.mask))
        assert record.picture.endswith(suffix)
        assert codes.dtype == dtype
        np.testing.assert_array_equal(codes[~mask], given[~mask])
        if factor > 1:
            assert codes[mask].max() > 1.5, "light above 1 is not clipped"


def test_other_tools_read_the_cameras(store: Store, room: SyntheticScene, inputs: Make) -> None:
    plates = export(store, inputs())
    for kind in ("read_binary", "read_text"):
        model = pycolmap.Reconstruction()
        getattr(model, kind)(str(plates.root / "sparse" / "0"))
        assert model.num_reg_images() == len(room.names)
        for image in model.images.values():
            camera = room.cameras[room.names.index(image.name.partition(".")[0])]
            np.testing.assert_allclose(image.cam_from_world().matrix(), camera.cam_from_world, atol=1e-6)
            assert (plates.root / "images" / image.name).is_file()
        assert model.compute_mean_reprojection_error() < 1
    frames = json.loads((plates.root / plates.metadata.transforms).read_text())["frames"]
    for frame, camera in zip(frames, room.cameras, strict=True):
        assert (plates.root / frame["file_path"]).is_file()
        pose = np.array(frame["transform_matrix"])[:3] @ np.diag([1, -1, -1, 1])
        np.testing.assert_allclose(pose, camera.world_from_cam, atol=1e-9)


def test_a_painted_view_is_in_its_plate_and_the_others(
    store: Store, room: SyntheticScene, photos: SyntheticScene, inputs: Make
) -> None:
    painted = np.broadcast_to(np.array([1.0, 0.0, 1.0], np.float32), photos.images[0].shape)
    folder = store.private_folder()
    write_png(folder / "pictures" / "a.png", painted)
    write_mask(folder / "masks" / "a.png", np.ones(painted.shape[:2], bool))
    view = PaintedView(name=room.names[0], picture="pictures/a.png", mask="masks/a.png")
    digest = store.put(folder, "painted-views", PaintedViews(views=(view,)))
    plates = export(store, inputs(code=SOURCE_CODES["painted"]) | {"painted-views": digest})
    first, second = plates.metadata.plates[:2]
    inside = read_image(plates.path(first.picture))[read_mask(plates.path(first.mask))]
    assert np.median(inside, 0) == pytest.approx([1, 0, 1], abs=0.1)
    carried = read_image(plates.path(second.picture))[read_mask(plates.path(second.mask))]
    assert np.median(carried, 0) == pytest.approx([1, 0, 1], abs=0.1)
    assert plates.metadata.canvases[0].name == room.names[0]


def test_completion_without_depth_is_refused(store: Store, room: SyntheticScene, inputs: Make) -> None:
    wired = inputs() | {"completed-views": put_completed(store, room, method="classical", depth=False)}
    with pytest.raises(BadInputError, match=r"no depth \(method classical\)"):
        export(store, wired)


def test_a_view_that_completion_left_out_gets_a_plate(store: Store, photos: SyntheticScene, inputs: Make) -> None:
    """It is completed from those that it saw."""
    plates = export(store, inputs(code=FIRST_PHOTO + 1, skip=1))
    record = plates.metadata.plates[0]
    picture, mask = read_image(plates.path(record.picture)), read_mask(plates.path(record.mask))
    assert np.abs(picture - photos.empty_images[0])[mask].mean() < 0.1
    assert np.abs(photos.images[0] - photos.empty_images[0])[mask].mean() > 0.15
