import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import ImageCorpus
from inpaint3d.contracts.models.manifest import MANIFEST, Manifest
from inpaint3d.contracts.store import FolderStore
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.diffusion_training.corpus import write_corpus
from inpaint3d.stages.diffusion_training.pictures import corpus_pictures

CAMERA = "0.5 0.9 0.5 0.5 0 0 1 0 0 0 0 1 0 0 0 0 1 0"
GREY = np.full((6, 8, 3), 128, np.uint8)


def clip(root: Path, place: str, video: str, frames: int) -> None:
    path = root / f"{place}.txt"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([f"https://video/{video}", *(f"{i} {CAMERA}" for i in range(frames))]))
    for i in range(frames):
        write_png(root / "frames" / path.stem / f"{i}.png", GREY)


def splits(pictures: tuple[ImageCorpus.Picture, ...]) -> dict[str, set[str]]:
    by_scene: dict[str, set[str]] = {}
    for picture in pictures:
        by_scene.setdefault(picture.scene, set()).add(picture.split)
    return by_scene


def test_a_folder_becomes_a_corpus_that_a_run_takes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png", "kitchen/1.png", "kitchen/2.png"):
        write_png(tmp_path / "in" / name, GREY)
    (tmp_path / "in" / "notes.md").write_text("left alone")
    write_corpus(tmp_path / "in", tmp_path / "out", held_out=0.0)
    store = FolderStore(tmp_path / "store")
    manifest = Manifest.model_validate_json((tmp_path / "out" / MANIFEST).read_bytes())
    corpus = store.open(store.adopt(tmp_path / "out", manifest), ImageCorpus)
    assert [p.scene for p in corpus.metadata.pictures] == ["a.png", "b.png", "kitchen", "kitchen"]
    assert len({p.name for p in corpus.metadata.pictures}) == 4
    assert corpus_pictures(corpus)[0].read().colour.shape == (6, 8, 3)


def test_pictures_of_a_scene_are_all_learnt_or_all_held_out(tmp_path: Path) -> None:
    for scene in range(60):
        for i in range(2):
            write_png(tmp_path / "in" / f"s{scene}" / f"{i}.png", GREY)
    first = splits(write_corpus(tmp_path / "in", tmp_path / "one", held_out=0.5))
    assert all(len(sides) == 1 for sides in first.values())
    # 60 draws of a half: within 3.6 standard deviations.
    assert 16 < sum(sides == {"test"} for sides in first.values()) < 44
    # More pictures move no scene to the other side.
    write_png(tmp_path / "in" / "s60" / "0.png", GREY)
    again = splits(write_corpus(tmp_path / "in", tmp_path / "two", held_out=0.5))
    assert {scene: again[scene] for scene in first} == first


def test_realestate10k_is_split_by_video_and_thinned(tmp_path: Path) -> None:
    for i in range(40):
        clip(tmp_path / "in", f"cameras/clip{i}", video=f"v{i // 2}", frames=5)
    pictures = write_corpus(tmp_path / "in", tmp_path / "out", held_out=0.5, every=2)
    assert len(pictures) == 40 * 3
    by_video = splits(pictures)
    assert len(by_video) == 20
    assert all(len(sides) == 1 for sides in by_video.values())
    assert set.union(*by_video.values()) == {"train", "test"}


def test_realestate10ks_own_split_is_kept(tmp_path: Path) -> None:
    clip(tmp_path / "in", "test/one", video="a", frames=1)
    clip(tmp_path / "in", "train/two", video="b", frames=1)
    split_of = {p.name: p.split for p in write_corpus(tmp_path / "in", tmp_path / "out", held_out=0.5)}
    assert split_of == {"one_0": "test", "two_0": "train"}


def test_what_cannot_be_a_corpus_is_named(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    with pytest.raises(BadInputError, match="no pictures in"):
        write_corpus(tmp_path / "in", tmp_path / "out")
    (tmp_path / "in" / "broken.jpg").write_bytes(b"no picture")
    command = [sys.executable, "-m", "inpaint3d.stages.diffusion_training.corpus"]
    result = subprocess.run([*command, str(tmp_path / "in"), str(tmp_path / "out")], capture_output=True, text=True)
    assert result.returncode == 3
    assert "broken.jpg is not a picture that can be read" in result.stderr
    assert not (tmp_path / "out").exists()
    (tmp_path / "in" / "broken.jpg").unlink()
    for name in ("a_b.png", "a/b.png"):
        write_png(tmp_path / "in" / name, GREY)
    with pytest.raises(BadInputError, match="would both be called a_b_png; rename one"):
        write_corpus(tmp_path / "in", tmp_path / "out")
    (tmp_path / "out").mkdir()
    with pytest.raises(BadInputError, match="is there already"):
        write_corpus(tmp_path / "in", tmp_path / "out")
