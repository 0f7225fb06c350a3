"""Bad input: one clear message that names the file and the repair, the documented exit code, nothing committed."""

import numpy as np
import pytest

from inpaint3d.contracts.models.artifacts import Capture
from inpaint3d.contracts.store import FolderStore
from inpaint3d.scene.image_io import write_mask, write_png
from inpaint3d.scene.synthetic import synthetic_scene

SCENE = synthetic_scene(views=4)


def pictures(folder, count=4):
    for name, image in list(zip(SCENE.names, SCENE.images, strict=True))[:count]:
        write_png(folder / f"{name}.png", image)


def cut_short(folder):
    """A real JPEG among good pictures, without its second half."""
    import OpenImageIO as oiio  # noqa: N813

    path = folder / "broken.jpg"
    out = oiio.ImageOutput.create(str(path))
    out.open(str(path), oiio.ImageSpec(48, 36, 3, "uint8"))
    out.write_image((SCENE.images[0] * 255).astype(np.uint8))
    out.close()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def another_aspect(folder):
    write_mask(folder.parent / "masks" / "view_001.png", np.ones((40, 40), bool))


@pytest.mark.parametrize(
    ("spoil", "count", "says"),
    [
        (lambda folder: None, 0, ["0 pictures", "at least 2"]),
        (lambda folder: None, 1, ["1 pictures", "at least 2"]),
        (cut_short, 4, ["broken.jpg", "copy it again"]),
        (lambda folder: (folder / "notes.png").write_text("no picture"), 4, ["notes.png", "replace or remove"]),
        (another_aspect, 4, ["mask view_001.png is for 40x40", "48x36", "another aspect ratio"]),
    ],
    ids=["empty", "one photo", "corrupt JPEG", "not a picture", "mask of another aspect"],
)
def test_captures_that_cannot_be_read(cli, tmp_path, spoil, count, says):
    folder = tmp_path / "tiny" / "images"
    folder.mkdir(parents=True)
    pictures(folder, count)
    spoil(folder)
    result = cli("run", str(tmp_path / "tiny"), "--only", "capture-ingest")
    assert result.returncode == 3, result.stderr
    for words in says:
        assert words in result.stderr
    assert str(cli.store) not in result.stderr, "the file to repair is the user's, not the store's copy"
    assert list(FolderStore(cli.store).records()) == []


def test_pictures_of_different_sizes_are_carried_as_they_are(cli, tmp_path):
    pictures(tmp_path / "tiny", 3)
    write_png(tmp_path / "tiny" / "view_003.png", np.rot90(SCENE.images[3])[::2, ::2])
    result = cli("run", str(tmp_path / "tiny"), "--only", "capture-ingest")
    assert result.returncode == 0, result.stderr
    (record,) = FolderStore(cli.store).records()
    frames = FolderStore(cli.store).open(record.outputs["capture"], Capture).metadata.frames
    assert [(f.width, f.height) for f in frames] == [(48, 36)] * 3 + [(18, 24)]


def test_broken_request_names_its_line(cli, tmp_path, capture):
    (tmp_path / "mask.yaml").write_text("mask:\n  kind: sphere\n  raduis: 0.2\n")
    result = cli("run", str(capture), "--stub", "--mask", str(tmp_path / "mask.yaml"))
    assert result.returncode == 2
    assert "mask.yaml:3: mask.sphere.raduis" in result.stderr


@pytest.mark.slow
def test_photos_of_unrelated_scenes(cli, tmp_path):
    folder = tmp_path / "tiny"
    rng = np.random.default_rng(0)
    for i in range(4):
        cells = rng.random((24, 32, 3)).astype(np.float32)
        write_png(folder / f"p{i}.png", np.kron(cells, np.ones((8, 8, 1), np.float32)))
    result = cli("run", str(folder), "--until", "pose-estimation")
    assert result.returncode == 3, result.stderr
    assert "pose-estimation failed" in result.stderr
    assert not any(r.stage.startswith("pose-estimation") for r in FolderStore(cli.store).records())


@pytest.mark.slow
def test_without_a_mask_the_run_waits_and_says_what_to_write(cli, tmp_path):
    """Poses come with the data, so that the run gets as far as the mask in seconds."""
    import json

    folder = tmp_path / "tiny"
    pictures(folder / "images")
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {
            "file_path": f"images/{n}.png",
            "transform_matrix": (np.vstack([c.world_from_cam, [0, 0, 0, 1]]) @ flip).tolist(),
        }
        for n, c in zip(SCENE.names, SCENE.cameras, strict=True)
    ]  # fmt: skip
    camera = SCENE.cameras[0]
    intrinsics = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": 48, "h": 36}
    (folder / "transforms.json").write_text(json.dumps({**intrinsics, "frames": frames}))
    tiny = ["nerf-pretraining.steps=2", "nerf-pretraining.view_side=24", "pose-estimation.min_points=1",
            "pose-estimation.min_angle_deg=0"]  # fmt: skip
    result = cli("run", str(folder), "--accept-doubtful", *[a for t in tiny for a in ("--set", t)])
    assert result.returncode == 4, result.stderr
    assert "mask-authoring waiting" in result.stderr
    assert "view_00" in result.stderr
