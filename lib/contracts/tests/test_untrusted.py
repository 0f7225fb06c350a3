import json
import struct

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.documents import load_yaml
from inpaint3d.contracts.models.untrusted import (
    MAX_DEPTH,
    UntrustedError,
    parse_json,
    parse_yaml,
    parse_yaml_documents,
    read_bounded,
    read_safetensors_header,
)

BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join([f'*{chr(97 + i)}'] * 9)}]\n" for i in range(9)
)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BOMB, "more than 1000000 values, with its aliases written out"),
        ("[" * 100_000, "in each other"),
        ("{a: " * 100_000, "in each other"),
        ("- " * 100_000, "in each other"),
        ("a: &x [*x]", "stands for what it is inside of"),
        ("a: *x", "for nothing"),
        ("a: !!int x", "cannot be read as what it is marked as"),
        ("a: !!timestamp x", "cannot be read as what it is marked as"),
        ("a: 2026-13-01", "cannot be read as what it is marked as"),
        ("a: " + "9" * 5000, "cannot be read as what it is marked as"),
        ("a: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
        ("? [1, 2]\n: 3", "a list or mapping stands where the name"),
        ("? {a: 1}\n: 3", "a list or mapping stands where the name"),
        ("a: 1\na: 2", "a stands here twice"),
    ],
)  # fmt: skip
def test_yaml_that_would_bring_down_its_reader_is_refused(text, says):
    with pytest.raises(UntrustedError, match=says):
        parse_yaml(text)


def test_yaml_within_the_bounds_is_read():
    deep = "[" * (MAX_DEPTH - 1) + "1" + "]" * (MAX_DEPTH - 1)
    value, _ = parse_yaml(f"a: {deep}\nb: &x {{c: 1}}\nd: *x\ne: {{<<: *x, f: 2}}")
    assert value["d"] == {"c": 1}
    assert value["e"] == {"c": 1, "f": 2}
    assert parse_yaml_documents("a: 1\n---\nb: 2\n") == [{"a": 1}, {"b": 2}]


def test_who_reads_a_file_names_it_and_the_line(tmp_path):
    (tmp_path / "request.yaml").write_text("a: 1\nb: &x [*x]\n")
    with pytest.raises(ConfigurationError, match=r"request\.yaml:2: \*x stands for"):
        load_yaml(tmp_path / "request.yaml")


@pytest.mark.parametrize(
    "data", [b"[" * 100_000, b'{"a":' * 100_000, b"\xff", b"{", b"9" * 5000, b"nul", b"", b'{"a": 1}}']
)
def test_json_that_cannot_be_read_is_refused(data):
    with pytest.raises(UntrustedError):
        parse_json(data)


def test_json_may_begin_with_a_byte_order_mark():
    assert parse_json(b"\xef\xbb\xbf[1]") == [1]


def test_no_more_than_the_limit_is_read(tmp_path):
    (tmp_path / "a").write_bytes(b"12345")
    assert read_bounded(tmp_path / "a", 5) == b"12345"
    with pytest.raises(UntrustedError, match="larger than"):
        read_bounded(tmp_path / "a", 4)


def _safetensors(path, header, body=b""):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + body)
    return path


def test_a_safetensors_header_says_what_is_there(tmp_path):
    described = {"dtype": "F32", "shape": [2, 3], "data_offsets": [0, 24]}
    path = _safetensors(tmp_path / "a", {"__metadata__": {"a": "b"}, "x": described}, bytes(24))
    assert read_safetensors_header(path) == {"x": ("F32", (2, 3))}


@pytest.mark.parametrize(
    "change",
    [
        {"shape": [2**40]}, {"shape": [-1, -6]}, {"shape": "6"}, {"shape": [2.5]}, {"dtype": "F33"}, {"dtype": None},
        {"data_offsets": [0, 2**60]}, {"data_offsets": [True, 24]},
        {"shape": [True, 6]}, {"data_offsets": [8, 0]}, {"data_offsets": [-24, 0]}, {"data_offsets": 3},
        {"data_offsets": [0, 20]},
    ],
)  # fmt: skip
def test_a_safetensors_header_that_lies_is_refused(tmp_path, change):
    described = {"dtype": "F32", "shape": [2, 3], "data_offsets": [0, 24], **change}
    with pytest.raises(UntrustedError, match="array 'x'"):
        read_safetensors_header(_safetensors(tmp_path / "a", {"x": described}, bytes(24)))


@pytest.mark.parametrize(
    ("spans", "size", "says"),
    [
        ([(0, 8), (4, 12)], 12, "array 'b' begins at byte 4, not where the last ended .8."),
        ([(0, 8), (12, 20)], 20, "array 'b' begins at byte 12"),
        ([(0, 8), (8, 16)], 17, "said to take 16 bytes, but 17 are there"),
        ([(0, 8), (8, 16)], 15, "said to take 16 bytes, but 15 are there"),
    ],
)
def test_arrays_that_overlap_or_leave_bytes_over_are_refused(tmp_path, spans, size, says):
    header = {n: {"dtype": "F32", "shape": [2], "data_offsets": list(s)} for n, s in zip("ab", spans, strict=True)}
    with pytest.raises(UntrustedError, match=says):
        read_safetensors_header(_safetensors(tmp_path / "a", header, bytes(size)))


@pytest.mark.parametrize("data", [b"", b"12", struct.pack("<Q", 2**60), struct.pack("<Q", 2) + b"[]", bytes(64)])
def test_what_is_no_safetensors_file_is_refused(tmp_path, data):
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(UntrustedError, match=r"safetensors|JSON"):
        read_safetensors_header(tmp_path / "a")
