"""Checkpoints against their damage, with the bytes of a safetensors file and none of its library."""

import json
import random

import pytest

from inpaint3d.contracts.kit.checkpoints import OPEN_SEAL, find_checkpoint, is_sealed, previous_of, write_checkpoint


def written(path, content):
    """A safetensors file of one tensor of bytes, sealed."""
    tensor = {"dtype": "U8", "shape": [len(content)], "data_offsets": [0, len(content)]}
    header = json.dumps({"__metadata__": OPEN_SEAL, "a": tensor}).encode()
    write_checkpoint(path, lambda staged: staged.write_bytes(len(header).to_bytes(8, "little") + header + content))
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "checkpoint.safetensors"


def test_two_generations_are_kept_and_nothing_else(path):
    for content in (b"1", b"2", b"3"):
        written(path, content)
    assert path.read_bytes()[-1:] == b"3"
    assert previous_of(path).read_bytes()[-1:] == b"2"
    assert sorted(path.parent.iterdir()) == sorted([path, previous_of(path)])
    assert find_checkpoint(path) == path


def test_every_flipped_bit_and_every_cut_is_found(path):
    good = written(path, bytes(range(64))).read_bytes()
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        path.write_bytes(bad)
        assert not is_sealed(path), bit
    for length in range(len(good)):
        path.write_bytes(good[:length])
        assert not is_sealed(path), length
    path.write_bytes(good + b"\0")
    assert not is_sealed(path)
    path.write_bytes(good)
    assert is_sealed(path)


@pytest.mark.parametrize("harm", ["cut", "junk", "empty", "gone", "folder"])
def test_the_generation_before_is_fallen_back_to_with_a_note(path, capsys, harm):
    written(path, b"1" * 100)
    good = written(path, b"2" * 100).read_bytes()
    path.unlink()
    if harm == "folder":
        path.mkdir()
    elif harm != "gone":
        path.write_bytes({"cut": good[:-1], "junk": random.Random(0).randbytes(99), "empty": b""}[harm])
    assert find_checkpoint(path) == previous_of(path)
    assert ("is damaged" in capsys.readouterr().err) == (harm != "gone")
    assert not path.exists()
    written(path, b"3")
    assert find_checkpoint(path) == path


def test_where_no_generation_is_whole_there_is_no_checkpoint(path, capsys):
    for generation in (path, previous_of(path)):
        generation.write_bytes(b"written by something else")
    assert find_checkpoint(path) is None
    assert capsys.readouterr().err.count("is damaged") == 2
    assert list(path.parent.iterdir()) == []


def test_a_file_that_was_not_written_to_be_sealed_is_a_bug(path):
    with pytest.raises(ValueError, match="OPEN_SEAL"):
        write_checkpoint(path, lambda staged: staged.write_bytes(b"\x02\0\0\0\0\0\0\0{}"))
