import pytest
import yaml

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models import untrusted
from inpaint3d.contracts.models.artifacts import MaskRequest
from inpaint3d.contracts.models.documents import load_document, load_yaml


def write(tmp_path, text):
    path = tmp_path / "request.yaml"
    path.write_text(text)
    return path


def test_lines_of_keys_and_items(tmp_path):
    _, lines = load_yaml(write(tmp_path, "a:\n  - 1\n  - b: 2\n"))
    assert lines[("a",)] == 1
    assert lines[("a", 0)] == 2
    assert lines[("a", 1, "b")] == 3


def test_typo_is_named_with_its_line(tmp_path):
    with pytest.raises(ConfigurationError, match=r"request\.yaml:3: mask\.sphere\.raduis"):
        load_document(write(tmp_path, "mask:\n  kind: sphere\n  raduis: 1\n"), MaskRequest)


def test_wrong_value_is_shown(tmp_path):
    with pytest.raises(ConfigurationError, match=r":3: .*greater than 0, got -1"):
        load_document(write(tmp_path, "mask:\n  kind: sphere\n  radius: -1\n"), MaskRequest)


@pytest.mark.parametrize(
    ("text", "says"),
    [("a: [1\n", "not valid YAML"), ("a: 1\na: 2\n", ":2: a stands here twice"), ("", "whole document")],
)
def test_broken_documents(tmp_path, text, says):
    with pytest.raises(ConfigurationError, match=says):
        load_document(write(tmp_path, text), MaskRequest)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match=r"nowhere\.yaml"):
        load_document(tmp_path / "nowhere.yaml", MaskRequest)


def test_both_parsers_read_the_same_with_the_same_lines(tmp_path, monkeypatch):
    path = write(tmp_path, "# a comment\na:\n  - &one {b: 1.5, c: yes}\n  - *one\nd: |\n  two\n  lines\n")
    fast = load_yaml(path)
    monkeypatch.setattr(untrusted, "LOADER", yaml.SafeLoader)
    assert load_yaml(path) == fast
    assert fast[0] == {"a": [{"b": 1.5, "c": True}] * 2, "d": "two\nlines\n"}
