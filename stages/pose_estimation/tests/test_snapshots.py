"""What a killed run goes on from, damaged in every way that a disk knows."""

import contextlib
from pathlib import Path

import pycolmap
import pytest

from inpaint3d.contracts.errors import InterruptedRun
from inpaint3d.stages.pose_estimation.features import create_database
from inpaint3d.stages.pose_estimation.snapshots import keep_snapshots, restore_snapshot, save_snapshot

CAMERAS = [pycolmap.Camera.create_from_model_name(n, "SIMPLE_RADIAL", 600, 640, 480) for n in (1, 2)]


def flip_bit(path: Path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


def count_cameras(path: Path) -> int:
    with pycolmap.Database.open(path) as database:
        return database.num_cameras()


def test_a_database_is_what_was_kept_of_it_whatever_lies_there(tmp_path: Path) -> None:
    path = tmp_path / "capture.db"
    create_database(path, CAMERAS[:1])
    save_snapshot(path)
    kept = path.read_bytes()
    for at in range(0, len(kept), 997):
        flip_bit(path, at)
        (tmp_path / "capture.db-wal").write_bytes(b"what a kill left of a log")
        create_database(path, CAMERAS)
        assert path.read_bytes() == kept
        assert not (tmp_path / "capture.db-wal").exists()


def test_of_a_damaged_snapshot_the_one_before_it_is_taken_and_then_none(tmp_path: Path, capsys) -> None:
    path, newest, previous = (tmp_path / f"capture.db{s}" for s in ("", ".safetensors", ".previous.safetensors"))
    for cameras in (CAMERAS[:1], CAMERAS):
        path.unlink(missing_ok=True)
        with pycolmap.Database.open(path) as database:
            for camera in cameras:
                database.write_camera(camera, use_camera_id=True)
        save_snapshot(path)
    flip_bit(newest, -1)
    create_database(path, [])
    assert count_cameras(path) == 1
    assert "is damaged" in capsys.readouterr().err
    flip_bit(previous, -1)
    create_database(path, [])
    assert count_cameras(path) == 0


@pytest.mark.parametrize("files", [{}, {"0/images.bin": b"poses", "1/images.bin": b"", "0/points3D.bin": b"points"}])
def test_a_folder_is_restored_with_its_files_alone(tmp_path: Path, files: dict[str, bytes]) -> None:
    folder = tmp_path / "models"
    assert not restore_snapshot(folder)
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    save_snapshot(folder)
    (folder / "2").mkdir(parents=True)
    (folder / "2" / "images.bin").write_bytes(b"a mapping that did not end")
    assert restore_snapshot(folder)
    assert {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()} == files


ENDS = [(None, True), (InterruptedRun("stopped"), True), (RuntimeError("a bug"), False)]


@pytest.mark.parametrize(("end", "kept"), ENDS)
def test_what_was_done_is_kept_at_the_end_and_when_interrupted(tmp_path: Path, end: Exception | None, kept: bool):
    path = tmp_path / "work.db"
    path.write_bytes(b"done")
    with contextlib.suppress(InterruptedRun, RuntimeError), keep_snapshots(path) as keep_when_due:
        keep_when_due()
        assert not (tmp_path / "work.db.safetensors").exists(), "it was not due"
        if end is not None:
            raise end
    assert restore_snapshot(path) is kept
