"""Whose fault an exception is, told by what the functions that it came through were given."""

import errno
import json
import os
import struct

import pytest

from inpaint3d.contracts.errors import BadInputError, ConfigurationError, StorageError
from inpaint3d.contracts.kit.blame import find_fault
from inpaint3d.contracts.kit.invocation import load_invocation
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.store import FolderStore


@pytest.fixture
def source(tmp_path):
    store = FolderStore(tmp_path / "store")
    folder = store.private_folder()
    (folder / "raw").mkdir()
    (folder / "raw" / "transforms.json").write_text('{"frames": []}')
    return store.open(store.put(folder, "source", Source(name="a", kind="folder")), Source)


def read_focal_length(path):
    return json.loads(path.read_text())["fl_x"]


def read_header(path):
    return struct.unpack("<Q", path.read_bytes()[:4])


def read_metadata(artifact):
    return Source.model_validate({"name": artifact.root.name})


def fail_with(error, path):
    raise error


def fault_of(call, *given, opened):
    try:
        call(*given)
    except Exception as error:
        return find_fault(error, opened)
    raise AssertionError("it did not fail")


@pytest.mark.parametrize(("read", "says"), [(read_focal_length, "KeyError: 'fl_x'"), (read_header, "error: unpack")])
def test_what_a_reader_of_an_inputs_file_makes_of_it_is_bad_input(source, read, says):
    fault = fault_of(read, source.root / "raw" / "transforms.json", opened={"capture": source.root})
    assert isinstance(fault, BadInputError)
    assert str(fault).startswith(f"capture: transforms.json cannot be read ({says}")
    assert str(source.root) not in str(fault), "the file to repair is the user's, not the store's copy"


def test_an_artifact_whose_data_is_invalid_is_named(source):
    fault = fault_of(read_metadata, source, opened={"capture": source.root})
    assert isinstance(fault, BadInputError)
    assert str(fault).startswith("input capture cannot be read (kind: Field required")


def test_a_bug_stays_a_bug(source, tmp_path):
    opened, file = {"capture": source.root}, source.root / "raw" / "transforms.json"
    (tmp_path / "own.json").write_text("{}")
    assert fault_of(read_focal_length, tmp_path / "own.json", opened=opened) is None, "no input's file"
    assert fault_of(fail_with, RuntimeError("no convergence"), file, opened=opened) is None, "no error of reading"
    assert fault_of(lambda: {}["a"], opened=opened) is None


def test_the_machine_comes_first(source):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/x")
    assert isinstance(fault_of(fail_with, full, source.root, opened={"capture": source.root}), StorageError)


@pytest.mark.parametrize(
    ("text", "says"), [('{"sead": 1}', "sead: Extra inputs"), ("", "Invalid JSON"), (None, "No such file")]
)
def test_an_invocation_alone_is_blamed_for_what_is_wrong_with_it(tmp_path, text, says):
    path = tmp_path / "invocation.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigurationError, match=says) as caught:
        load_invocation(path)
    assert "invocation.json" in str(caught.value)
