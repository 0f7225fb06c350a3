from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.realestate10k import read_clips
from inpaint3d.scene.synthetic import synthetic_scene

SCENE = synthetic_scene(views=3, width=32, height=24, points=20)


def row(timestamp: int, camera) -> str:
    shares = (camera.fx / 32, camera.fy / 24, camera.cx / 32, camera.cy / 24)
    return " ".join(map(repr, [timestamp, *map(float, [*shares, 0, 0, *camera.cam_from_world.ravel()])]))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Two clips of one video; of the second's three frames one is there; a third clip has no frames at all."""
    for split, name, there in (("train", "a1", 3), ("test", "b2", 1), ("test", "c3", 0)):
        path = tmp_path / "RealEstate10K" / split / f"{name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        rows = [row(1000 * i, camera) for i, camera in enumerate(SCENE.cameras)]
        path.write_text("\n".join(["https://www.youtube.com/watch?v=x", *rows]) + "\n")
        for i in range(there):
            write_png(tmp_path / "frames" / name / f"{1000 * i}.png", SCENE.images[i])
    (tmp_path / "README.txt").write_text("not a clip\n")
    return tmp_path


def test_clips_come_with_the_frames_that_are_there_and_their_cameras(root: Path) -> None:
    first, second = read_clips(root)
    assert (first.name, first.split, second.name, second.split) == ("b2", "test", "a1", "train")
    assert [len(first.frames), len(second.frames)] == [1, 3]
    assert first.video == second.video == "https://www.youtube.com/watch?v=x"
    for frame, camera in zip(second.frames, SCENE.cameras, strict=True):
        np.testing.assert_allclose(frame.world_from_cam, camera.world_from_cam, atol=1e-12)
        assert frame.intrinsics == pytest.approx((camera.fx / 32, camera.fy / 24, camera.cx / 32, camera.cy / 24))
    assert [frame.image.stem for frame in second.frames] == ["0", "1000", "2000"]


@pytest.mark.parametrize(
    ("damage", "message"),
    [("17 columns", "2 columns"), ("1 nan" + " 0" * 17, "1 of them not finite"), ("5 a b", "could not convert")],
)
def test_a_row_that_is_no_camera_is_named(root: Path, damage: str, message: str) -> None:
    path = root / "RealEstate10K" / "train" / "a1.txt"
    path.write_text(path.read_text().replace("\n1000 ", "\n" + damage + "\n1000 ", 1).replace("17 columns", "17 0"))
    with pytest.raises(BadInputError, match=rf"a1\.txt, line 3: .*{message}"):
        read_clips(root)
