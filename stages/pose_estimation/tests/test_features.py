"""The database of features and matches."""

from pathlib import Path

import numpy as np
import pycolmap

from inpaint3d.contracts.kit.context import Context
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.features import add_pictures, create_database, features_of


def test_pictures_are_numbered_as_given_however_fast_each_is_done(tmp_path: Path) -> None:
    """Of two threads the one with the plain pictures is done first; the mapper goes by the numbers."""
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    plain = np.zeros_like(noise)
    plain[200:240, 300:360] = 255
    names = [f"{i}.png" for i in range(6)]
    for i, name in enumerate(names):
        write_png(tmp_path / name, plain if i % 2 else noise)
    database = tmp_path / "database.db"
    create_database(database, [pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 600, 640, 480)])
    ctx = Context(seed=0, device="cpu", threads=2, work=tmp_path, emit=lambda event, **values: None)
    add_pictures(database, tmp_path, {1: names}, Config(), ctx)
    with pycolmap.Database.open(database) as db:
        assert {image.name: image.image_id for image in db.read_all_images()} == {n: i + 1 for i, n in enumerate(names)}
        assert len(features_of(db, "0.png")) > len(features_of(db, "1.png")) > 0
