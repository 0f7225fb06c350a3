"""The synthetic room as a run has it before there is a mask: pictures, cameras, and a field with exact depth."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.store import FolderStore
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from tests.mask_bench import field
from tests.room_artifacts import put_posed


@dataclass(frozen=True)
class Room:
    """A store with the room in it, and what it shows."""

    store: FolderStore
    scene: SyntheticScene
    capture: Digest
    posed: Digest
    field: Digest

    def middle_of_ball(self, view: int) -> tuple[float, float]:
        """In pixels of a view."""
        x, y = self.scene.cameras[view].project(np.zeros(3))[0]
        return round(float(x), 1), round(float(y), 1)


def build_room(folder: Path, views: int = 5, width: int = 120, height: int = 90) -> Room:
    store = FolderStore(folder)
    scene = synthetic_scene(views=views, width=width, height=height, arc_deg=60)
    return Room(store, scene, put_capture(store, scene), put_posed(store, scene, scene.images), field(store, scene))


def put_capture(store: FolderStore, scene: SyntheticScene) -> Digest:
    folder, frames = store.private_folder(), []
    for name, image in zip(scene.names, scene.images, strict=True):
        write_png(folder / f"frames/{name}.png", image)
        height, width = image.shape[:2]
        frames.append(CapturedFrame(name=name, path=f"frames/{name}.png", width=width, height=height))
    return store.put(folder, "capture", Capture(layout="photos", ordered=True, frames=tuple(frames)))
