import hashlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.canonical import canonical_json, digest_of, file_digest

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(st.dictionaries(st.text(), VALUES))
def test_order_of_keys_does_not_matter(value):
    assert canonical_json(dict(reversed(value.items()))) == canonical_json(value)


@given(VALUES)
def test_reads_back_as_itself(value):
    assert json.loads(canonical_json(value)) == value


@pytest.mark.parametrize("value", [float("nan"), float("inf"), {"deep": [float("-inf")]}])
def test_refuses_what_json_has_no_word_for(value):
    with pytest.raises(ConfigurationError, match="finite"):
        canonical_json(value)


def test_known_digests(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    # FIPS 180-2's own example.
    assert file_digest(tmp_path / "a").endswith("ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad")
    assert digest_of({"b": 1, "a": 2}) == "sha256:" + hashlib.sha256(b'{"a":2,"b":1}').hexdigest()
