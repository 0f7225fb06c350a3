"""What a capture may reach: its own folder, and nothing that a run left behind in it."""

import os
from pathlib import Path

import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.orchestrator.source_files import list_source_files


def put(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(name.encode())
    return folder


def listed(root: Path) -> list[str]:
    return [p.relative_to(root).as_posix() for p in list_source_files(root)]


def test_links_inside_are_followed(tmp_path):
    root = put(tmp_path / "scene", "photos/a.jpg", "notes.txt")
    (root / "images").symlink_to("photos")
    (root / "b.jpg").symlink_to("photos/a.jpg")
    assert listed(root) == ["b.jpg", "images/a.jpg", "notes.txt", "photos/a.jpg"]


@pytest.mark.parametrize("target", ["../outside/secret.jpg", "/etc/passwd"])
@pytest.mark.parametrize("place", ["a.jpg", "images/a.jpg"])
def test_a_link_to_a_file_outside_is_refused_by_name(tmp_path, target, place):
    put(tmp_path / "outside", "secret.jpg")
    root = put(tmp_path / "scene", "b.jpg", "images/c.jpg")
    (root / place).symlink_to(
        target if target.startswith("/") else os.path.relpath(tmp_path / target[3:], (root / place).parent)
    )
    with pytest.raises(BadInputError, match=rf"{place} is a link to .*, outside the capture"):
        list_source_files(root)


def test_the_folder_where_the_photographs_are_kept_gives_pictures_alone(tmp_path):
    kept = put(tmp_path / "photos", "a.jpg", "b.JPG", "walk.mp4", "id_rsa", "passwords.txt", ".hidden/c.jpg")
    root = tmp_path / "scene"
    root.mkdir()
    (root / "images").symlink_to(kept)
    assert listed(root) == ["images/a.jpg", "images/b.JPG", "images/walk.mp4"]
    (kept / "d.jpg").symlink_to(put(tmp_path / "private", "d.jpg") / "d.jpg")
    with pytest.raises(BadInputError, match=r"d\.jpg is a link to .*private/d\.jpg, outside"):
        list_source_files(root)


@pytest.mark.parametrize("target", ["..", ".", "../.."])
def test_a_link_in_a_circle_is_refused_by_name(tmp_path, target):
    root = put(tmp_path / "scene", "a.jpg", "images/b.jpg")
    (root / "images" / "again").symlink_to(target)
    with pytest.raises(BadInputError, match="images/again is a link to"):
        list_source_files(root)


def test_links_that_lead_nowhere_are_named(tmp_path):
    root = put(tmp_path, "a.jpg")
    (root / "gone.jpg").symlink_to("nothing.jpg")
    with pytest.raises(BadInputError, match=r"gone\.jpg is a link to nothing\.jpg, which is not there"):
        list_source_files(root)
    (root / "gone.jpg").unlink()
    (root / "self.jpg").symlink_to("self.jpg")
    with pytest.raises(BadInputError, match=r"self\.jpg is a link"):
        list_source_files(root)


def test_results_of_runs_are_no_input(tmp_path):
    root = put(tmp_path, "a.jpg", "runs.txt", "walks/b.jpg")
    before = listed(root)
    put(root, "runs/kitchen/metrics.json", "runs/kitchen/pictures/c.png", "runs/kitchen/logs/x.log", "runs/all.json")
    put(root, "store/objects/d.jpg", "store/work/x", "store/tmp/x", "store/locks/x", "store/quarantine/x")
    put(root, ".inpaint3d/objects/e.jpg")
    assert listed(root) == before == ["a.jpg", "runs.txt", "walks/b.jpg"]


def test_a_folder_that_is_called_runs_is_not_passed_over_for_its_name(tmp_path):
    assert listed(put(tmp_path, "runs/a.jpg", "runs/b.jpg")) == ["runs/a.jpg", "runs/b.jpg"]


def test_names_that_no_manifest_can_hold_are_refused(tmp_path):
    with pytest.raises(BadInputError, match="backslash; rename it"):
        list_source_files(put(tmp_path / "a", "left\\1.jpg"))
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / os.fsdecode(b"\xff.jpg")).touch()
    with pytest.raises(BadInputError, match="is not UTF-8; rename the file"):
        list_source_files(tmp_path / "b")


def test_what_is_no_file_is_passed_over(tmp_path):
    root = put(tmp_path, "a.jpg")
    os.mkfifo(root / "pipe.jpg")
    assert listed(root) == ["a.jpg"]


@pytest.mark.parametrize("name", ["a\nb.jpg", "a\tb.jpg", "walk/\x1b[2J.jpg"])
def test_names_that_would_break_lists_and_terminals_are_refused(tmp_path, name):
    root = put(tmp_path, "a.jpg", name)
    with pytest.raises(BadInputError, match="holds a control character; rename the file") as refusal:
        list_source_files(root)
    assert str(refusal.value).isprintable()
