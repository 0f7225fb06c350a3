"""Compiled templates are kept, and never believed where they are not what was compiled from the source."""

from pathlib import Path

import pytest
from jinja2 import DictLoader, Environment

from inpaint3d.report.bytecode import TemplateBytecode


def render(folder: Path, source: str) -> str:
    environment = Environment(
        loader=DictLoader({"a.html": source}), bytecode_cache=TemplateBytecode(folder), autoescape=True
    )
    return environment.get_template("a.html").render(value=3)


def test_a_template_that_changed_is_compiled_again(tmp_path: Path) -> None:
    folder = tmp_path / "__pycache__"
    assert render(folder, "first {{ value }}") == "first 3"
    (file,) = folder.iterdir()
    before = file.read_bytes()
    assert render(folder, "first {{ value }}") == "first 3"
    assert render(folder, "second {{ value }}") == "second 3"
    assert (file,) == tuple(folder.iterdir())
    assert file.read_bytes() != before


@pytest.mark.parametrize("content", [b"", b"j2", b"nothing of ours"])
def test_a_file_that_is_none_is_written_anew(tmp_path: Path, content: bytes) -> None:
    folder = tmp_path / "__pycache__"
    render(folder, "first {{ value }}")
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(content)
    assert render(folder, "first {{ value }}") == "first 3"
    assert file.read_bytes() == whole
    for damaged in (whole[: len(whole) // 2], whole[:-9] + bytes([whole[-9] ^ 1]) + whole[-8:]):
        file.write_bytes(damaged)
        assert render(folder, "first {{ value }}") == "first 3"
        assert file.read_bytes() == whole


def test_a_folder_that_cannot_be_made_costs_nothing_but_time(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert render(tmp_path / "file" / "__pycache__", "first {{ value }}") == "first 3"
