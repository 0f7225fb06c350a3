"""`inpaint3d evaluate-dataset` on a miniature of two scenes in SPIn-NeRF's layout."""

import json
from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.models.artifacts import Capture, Truth
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.dataset import DATASETS, SceneScore, find_scenes, tabulate
from inpaint3d.orchestrator.history import History
from inpaint3d.scene.image_io import write_mask, write_png
from inpaint3d.scene.synthetic import synthetic_scene


def llff_row(camera) -> np.ndarray:
    """A row of poses_bounds.npy: columns down, right, back, place, (h, w, focal); then the bounds."""
    right, down, forward = camera.rotation.T
    size = np.array([camera.height, camera.width, camera.fx])
    return np.concatenate([np.stack([down, right, -forward, camera.centre, size], 1).ravel(), [0.1, 3.0]])


def write_scene(folder: Path, seed: int) -> None:
    """Forty views without the ball, six with it: as there, the first forty files are the truth."""
    scene = synthetic_scene(views=46, seed=seed)
    for i, name in enumerate(scene.names):
        pictures, labels = (scene.empty_images, "test_label") if i < 40 else (scene.images, "label")
        write_png(folder / "images_4" / f"{name}.png", pictures[i])
        write_mask(folder / "images_4" / labels / f"{name}.png", scene.object_masks[i])
    np.save(folder / "poses_bounds.npy", np.stack([llff_row(c) for c in scene.cameras]))


@pytest.fixture(scope="module")
def miniature(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("spin-nerf")
    for seed, name in enumerate(("book", "trash")):
        write_scene(folder / name, seed)
    (folder / "readme.txt").write_text("not a scene")
    (folder / "notes").mkdir()
    return folder


def test_every_scene_is_run_under_the_preset_and_stands_in_the_table(cli, miniature):
    result = cli("evaluate-dataset", "spin-nerf", str(miniature), "--stub")
    assert result.returncode == 0, result.stderr
    table = json.loads((cli.runs / "spin-nerf.json").read_text())
    assert [s["name"] for s in table["scenes"]] == ["book", "trash"]
    for scene in table["scenes"]:
        assert scene["figures"]["psnr"] > 0
        assert scene["protocol"]
    mean = sum(s["figures"]["psnr"] for s in table["scenes"]) / 2
    assert table["mean"]["figures"]["psnr"] == pytest.approx(mean)
    assert table["published"][1]["figures"] == {"psnr": 17.37, "ssim": 0.463, "lpips_vgg": 0.515, "fid": 226.04}
    records = {r["name"]: r["preset"] for r in json.loads(cli("runs", "--json").stdout)}
    assert records == {"spin-nerf-book": "spin-nerf", "spin-nerf-trash": "spin-nerf"}
    shown = cli("evaluate-dataset", "spin-nerf", str(miniature), "--stub", "--scene", "trash")
    assert "mean of 1 of 1 scenes" in shown.stdout
    assert "Inpaint3D (published)" in shown.stdout
    assert "spin-nerf-book" not in shown.stderr


def test_the_first_forty_files_are_truth_and_never_trained_on(cli, miniature):
    """The layout, read by the stage itself."""
    result = cli("run", str(miniature / "book"), "--name", "book", "--until", "capture-ingest")
    assert result.returncode == 0, result.stderr
    store = FolderStore(cli.store)
    outputs = next(n.outputs for n in History(store).latest("book").nodes if n.node == "capture-ingest")
    capture, truth = store.open(outputs["capture"], Capture), store.open(outputs["truth"], Truth)
    assert [f.name for f in capture.metadata.frames] == [f"view_{i:03d}" for i in range(40, 46)]
    assert [f.name for f in truth.metadata.frames] == [f"view_{i:03d}" for i in range(40)]
    assert all(f.mask and f.camera for f in (*capture.metadata.frames, *truth.metadata.frames))


def test_a_scene_that_fails_is_left_out_and_decides_the_exit_code(cli, miniature, tmp_path):
    (tmp_path / "set").mkdir()
    for name in ("book", "trash"):
        (tmp_path / "set" / name).symlink_to(miniature / name)
    broken = tmp_path / "set" / "a-broken-one"
    (broken / "images_4").mkdir(parents=True)
    (broken / "poses_bounds.npy").write_bytes(b"not an array")
    result = cli("evaluate-dataset", "spin-nerf", str(tmp_path / "set"), "--scene", "a-broken-one")
    assert result.returncode == 3
    table = json.loads((cli.runs / "spin-nerf.json").read_text())
    assert table["mean"] == {"name": "mean of 0 of 1 scenes", "figures": {}}
    assert "a-broken-one" in result.stderr


def test_a_figure_that_a_scene_lacks_has_no_mean():
    scores = [SceneScore("a", "m", {"psnr": 20.0, "ssim": 0.5}), SceneScore("b", "m", {"psnr": 22.0}), SceneScore("c")]
    table = tabulate(DATASETS["spin-nerf"], scores)
    assert table["mean"] == {"name": "mean of 2 of 3 scenes", "figures": {"psnr": 21.0}}


def test_what_is_no_data_set_is_told(cli, miniature, tmp_path):
    none = cli("evaluate-dataset", "spin-nerf", str(tmp_path))
    assert none.returncode == 3
    assert "holds no scene" in none.stderr
    other = cli("evaluate-dataset", "llff", str(miniature))
    assert other.returncode == 2
    assert "there are spin-nerf" in other.stderr
    missing = cli("evaluate-dataset", "spin-nerf", str(miniature), "--scene", "tree")
    assert missing.returncode == 2
    assert "book, trash" in missing.stderr
    assert [p.name for p in find_scenes(DATASETS["spin-nerf"], miniature, None)] == ["book", "trash"]
