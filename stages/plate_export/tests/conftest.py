from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
import pytest

from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from tests.room_artifacts import put_completed, put_masks, put_posed

FINE = 4
"""How many times as wide as its posed view a photo is."""


@pytest.fixture(scope="session")
def room() -> SyntheticScene:
    return synthetic_scene(views=6)


@pytest.fixture(scope="session")
def photos() -> SyntheticScene:
    """What the same cameras show at the photos' size."""
    return synthetic_scene(views=6, width=48 * FINE, height=36 * FINE)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return FolderStore(tmp_path / "store")


def write_file(path: Path, pixels: np.ndarray, kind: str, **attributes: Any) -> None:
    """A picture [h, w, 3] of OpenImageIO's type `kind`, from values in 0 to 1 or light."""
    path.parent.mkdir(parents=True, exist_ok=True)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    for name, value in attributes.items():
        spec.attribute(name, value)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(np.ascontiguousarray(pixels, np.float32))
    assert output.close()


def put_capture(store: Store, photos: SyntheticScene, images: np.ndarray, suffix: str = "", kind: str = "") -> Digest:
    """A capture of photos; with a suffix, the frames' originals are files of that kind."""
    folder = store.private_folder()
    frames = []
    for name, image in zip(photos.names, images, strict=True):
        write_png(folder / "frames" / f"{name}.png", image.clip(0, 1))
        original = f"originals/{name}{suffix}" if suffix else None
        if original is not None:
            write_file(folder / original, image, kind)
        height, width = image.shape[:2]
        frames.append(
            CapturedFrame(name=name, path=f"frames/{name}.png", original=original, width=width, height=height)
        )
    return store.put(folder, "capture", Capture(layout="photos", ordered=True, frames=tuple(frames)))


@pytest.fixture
def inputs(store: Store, room: SyntheticScene, photos: SyntheticScene) -> Callable[..., dict[str, Any]]:
    """The stage's inputs: posed views of 48 x 36, photos four times as wide."""

    def make(images: np.ndarray | None = None, suffix: str = "", kind: str = "", **completed: Any) -> dict[str, Any]:
        camera = photos.cameras[0]
        return {
            "capture": put_capture(store, photos, photos.images if images is None else images, suffix, kind),
            "posed-capture": put_posed(store, room, room.images, (camera.fx, camera.fy, camera.cx, camera.cy)),
            "mask-set": put_masks(store, room.names, room.object_masks),
            "completed-views": put_completed(store, room, **completed),
        }

    return make
