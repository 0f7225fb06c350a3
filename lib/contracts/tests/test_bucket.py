"""What is a bucket's alone: transfers that break, checksums, the cache."""

import base64
import hashlib
import os

import pytest

from inpaint3d.contracts.errors import RetryableError, StorageError
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.store import Record
from inpaint3d.contracts.store.bucket import PART, BucketStore

COMPONENTS = {"seed": 1}
KEY = digest_of(COMPONENTS)
LARGE = 2 * PART + 1000


@pytest.fixture
def store(bucket, tmp_path):
    return BucketStore(bucket, tmp_path / "cache", retries=2)


@pytest.fixture
def reader(store, tmp_path):
    """Another machine."""
    return BucketStore(store.place, tmp_path / "another machine", retries=2)


def put(store, **files):
    folder = store.private_folder()
    (folder / "raw").mkdir()
    for name, data in files.items():
        (folder / "raw" / name).write_bytes(data)
    return store.put(folder, "source", Source(name="a", kind="folder"))


def sent(network, method, word):
    return [head for head in network.heads if head.startswith(method) and word in head.splitlines()[0]]


def test_a_large_file_goes_in_parts_each_with_its_sha256(store, network):
    data = os.urandom(LARGE)
    digest = put(store, a=data)
    parts = sent(network, "put", "partnumber=")
    assert len(parts) == 3
    for i in range(3):
        part = base64.b64encode(hashlib.sha256(data[i * PART : (i + 1) * PART]).digest()).decode().lower()
        assert any(f"x-amz-checksum-sha256: {part}" in head for head in parts)
    assert store.find_damage(digest) is None


def test_an_upload_cut_in_its_middle_is_tried_again(store, reader, network):
    network.cut_uploads = 1
    data = os.urandom(LARGE)
    digest = put(store, a=data)
    assert network.cut_uploads <= 0, "nothing was cut"
    assert len(sent(network, "put", "partnumber=")) == 4
    assert reader.open(digest, Source).path("raw/a").read_bytes() == data


def test_an_upload_that_never_gets_through_leaves_nothing_visible_and_says_so(store, reader, network):
    small, large = b"small", os.urandom(LARGE)
    network.cut_uploads = 10**6
    with pytest.raises(RetryableError, match=r"does not answer .* run again"):
        put(store, a=small, b=large)
    assert not reader.is_present(digest_of_both := next(iter(store.objects())))
    assert not reader.is_whole(digest_of_both)
    assert RetryableError.exit_code == 75

    network.cut_uploads = 0
    network.heads.clear()
    assert put(store, a=small, b=large) == digest_of_both
    assert sent(network, "put", "raw/a ") == [], "what was there whole went up a second time"
    assert reader.open(digest_of_both, Source).path("raw/b").read_bytes() == large


def test_a_download_cut_in_its_middle_goes_on_where_it_was(store, reader, network):
    data = os.urandom(LARGE)
    digest = put(store, a=data)
    network.heads.clear()
    network.cut_downloads = 1
    assert reader.open(digest, Source).path("raw/a").read_bytes() == data
    first, second = sent(network, "get", "raw/a ")
    assert "range: bytes=" not in first
    assert "range: bytes=" in second


def test_a_fetch_that_was_given_up_keeps_the_files_that_came_whole(store, reader, network):
    digest = put(store, a=b"small", b=os.urandom(LARGE))
    network.cut_downloads = 10**6
    with pytest.raises(RetryableError):
        reader.open(digest, Source)
    assert not reader.object_path(digest).exists()
    network.cut_downloads = 0
    network.heads.clear()
    reader.open(digest, Source)
    assert sent(network, "get", "raw/a ") == []


def test_what_is_cached_is_not_fetched_again_unless_it_was_damaged(store, network):
    digest = put(store, a=b"hello")
    network.heads.clear()
    store.open(digest, Source)
    assert network.heads == []
    file = store.object_path(digest) / "raw" / "a"
    file.chmod(0o644)
    file.write_bytes(b"hellO")
    assert store.open(digest, Source).path("raw/a").read_bytes() == b"hello"
    assert store.names("quarantine") == []


def test_looking_a_result_up_moves_no_bulk(store, reader, network):
    digest = put(store, a=os.urandom(LARGE))
    store.commit(Record(key=KEY, stage="s@1", components=COMPONENTS, outputs={"a": digest}, provenance={}, timings={}))
    network.heads.clear()
    assert reader.lookup(KEY) is not None
    assert sent(network, "get", "raw/") == []
    assert len(network.heads) == 3, "the key, the manifest, the listing"


def test_a_bucket_that_is_not_there_is_a_storage_error(store, tmp_path):
    with pytest.raises(StorageError, match=r"s3://nowhere-at-all/x.*check the bucket's name"):
        BucketStore("s3://nowhere-at-all/x", tmp_path / "c").write("a", b"")


def test_a_server_that_is_down_is_retryable(store, tmp_path, monkeypatch):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with pytest.raises(RetryableError, match="does not answer"):
        BucketStore("s3://artifacts/x", tmp_path / "c", retries=0).read("a")
