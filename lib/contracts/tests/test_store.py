"""What every store holds, be it a folder or a bucket; then what is a folder's alone (`test_bucket.py`: a bucket's)."""

import errno
import json
import multiprocessing
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from inpaint3d.contracts.errors import ArtifactError, ConfigurationError, StorageError, find_os_error, from_os_error
from inpaint3d.contracts.models.artifacts import Effect, EffectPlan, Source
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.manifest import MANIFEST, Manifest, read_metadata
from inpaint3d.contracts.store import FolderStore, Record, key_path, object_file, open_store, this_process
from inpaint3d.contracts.store.bucket import BucketStore

PLAN = EffectPlan(effects=(Effect(name="exposure", state="off", evidence={"ev": 0.01}, reason="still"),))


@pytest.fixture(params=["folder", "bucket"])
def store(request, tmp_path):
    if request.param == "folder":
        return FolderStore(tmp_path / "store")
    return BucketStore(request.getfixturevalue("bucket"), tmp_path / "cache")


@pytest.fixture
def folder_store(tmp_path):
    return FolderStore(tmp_path / "store")


def elsewhere(store, tmp_path, name="another machine"):
    """The same store, as another machine sees it."""
    return BucketStore(store.place, tmp_path / name) if isinstance(store, BucketStore) else FolderStore(store.root)


def put(store, text="hello"):
    folder = store.private_folder()
    (folder / "raw").mkdir()
    (folder / "raw" / "a.txt").write_text(text)
    return store.put(folder, "source", Source(name="a", kind="folder"))


def record(key, **outputs):
    return Record(key=key, stage="s@0.1.0", components=COMPONENTS, outputs=outputs, provenance={}, timings={})


COMPONENTS = {"stage": "s@0.1.0", "seed": 1}
KEY = digest_of(COMPONENTS)


def test_what_is_put_can_be_opened_and_is_the_same(store):
    artifact = store.open(put(store), Source)
    assert artifact.metadata == Source(name="a", kind="folder")
    assert artifact.path("raw/a.txt").read_text() == "hello"
    with pytest.raises(ArtifactError, match="no file raw/b"):
        artifact.path("raw/b.txt")


def test_equal_content_has_one_digest_and_one_folder(store):
    assert put(store) == put(store)
    assert put(store) != put(store, "other")
    assert len(list(store.objects())) == 2
    assert list((store.root / "tmp").iterdir()) == []


def test_metadata_of_another_schema_is_refused(store):
    with pytest.raises(ArtifactError, match="wants metadata EffectPlan, got Source"):
        store.put(store.private_folder(), "effect-plan", Source(name="a", kind="folder"))


def test_a_file_that_metadata_names_must_be_there(store):
    from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame

    frame = CapturedFrame(name="a", path="frames/a.png", width=2, height=2)
    with pytest.raises(ArtifactError, match=r"names frames/a\.png, which was not written"):
        store.put(store.private_folder(), "capture", Capture(layout="photos", ordered=False, frames=(frame,)))


@pytest.mark.parametrize("harm", ["flip", "truncate", "remove", "add", "manifest"])
def test_damage_is_found_quarantined_and_named(store, tmp_path, harm):
    digest = put(store)
    file, manifest = object_file(digest, "raw/a.txt"), object_file(digest, MANIFEST)
    if harm == "flip":
        store.write(file, b"hellO")
    elif harm == "truncate":
        store.write(file, b"h")
    elif harm == "remove":
        store.remove(file)
    elif harm == "add":
        store.write(object_file(digest, "extra"), b"")
    else:
        store.write(manifest, store.read(manifest).replace(b'"a"', b'"b"'))
    reader = elsewhere(store, tmp_path)
    assert reader.find_damage(digest) is not None
    with pytest.raises(ArtifactError, match="quarantine"):
        reader.open(digest, Source)
    assert not store.is_present(digest)
    assert len(store.names("quarantine")) == 1
    assert put(store) == digest
    assert elsewhere(store, tmp_path).open(digest, Source).path("raw/a.txt").read_text() == "hello"


def test_a_damaged_output_makes_its_key_unknown_again(store, tmp_path):
    """A folder notices when the key is looked up, a bucket at the latest when the bytes are read."""
    digest = put(store)
    store.commit(record(KEY, source=digest))
    assert store.lookup(KEY) is not None
    store.write(object_file(digest, "raw/a.txt"), b"hellO")
    reader = elsewhere(store, tmp_path)
    if isinstance(store, BucketStore):
        with pytest.raises(ArtifactError, match="sha256 differs"):
            reader.open(digest, Source)
    assert reader.lookup(KEY) is None
    put(reader)
    reader.commit(record(KEY, source=digest))
    assert store.lookup(KEY).outputs == {"source": digest}


def test_a_result_whose_artifact_lost_a_file_is_computed_again(store):
    digest = put(store)
    store.commit(record(KEY, source=digest))
    store.remove(object_file(digest, "raw/a.txt"))
    assert store.lookup(KEY) is None
    assert not store.is_present(digest)


def test_of_eight_writers_of_a_key_one_wins_and_all_get_its_result(store, tmp_path):
    writers = [elsewhere(store, tmp_path, str(i)) for i in range(8)]
    ready, got = threading.Barrier(8), {}

    def compute(i):
        digest = put(writers[i], f"result of {i}")
        ready.wait()
        got[i] = writers[i].commit(record(KEY, source=digest)).outputs["source"]

    threads = [threading.Thread(target=compute, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(got) == 8
    (winner,) = set(got.values())
    assert store.lookup(KEY).outputs == {"source": winner}
    assert len(list(store.records())) == 1
    assert store.find_damage(winner) is None


def test_documents_are_written_whole_listed_and_retired(store):
    assert store.read("runs/a/1.json") is None
    assert store.names("runs") == []
    store.write("runs/a/1.json", b"1")
    store.write("runs/a/1.json", b"2")
    store.write("runs/b/1.json", b"3")
    assert store.read("runs/a/1.json") == b"2"
    assert (store.names("runs"), store.names("runs/a")) == (["a", "b"], ["1.json"])
    assert not store.create("runs/a/1.json", b"4")
    store.retire("runs/a/1.json")
    assert store.create("runs/a/1.json", b"5")
    store.remove("runs/a/1.json")
    store.remove("runs/a/1.json")
    store.retire("runs/a/1.json")
    assert store.names("runs/a") == []


def test_an_artifact_can_be_weighed_and_dropped(store):
    digest = put(store)
    assert store.size(digest) == len(b"hello") + len(store.read(object_file(digest, MANIFEST)))
    store.drop_object(digest)
    assert list(store.objects()) == []
    assert not store.is_whole(digest)
    with pytest.raises(ArtifactError, match="is not in the store"):
        store.manifest(digest)


def test_first_commit_of_a_key_wins(store):
    first, second = put(store, "1"), put(store, "2")
    assert store.commit(record(KEY, source=first)).outputs == {"source": first}
    assert store.commit(record(KEY, source=second)).outputs == {"source": first}
    store.forget(KEY)
    assert store.commit(record(KEY, source=second)).outputs == {"source": second}


def test_torn_key_file_counts_as_nothing(store):
    store.write(key_path(KEY), b'{"key": "sha2')
    assert list(store.records()) == []
    assert store.lookup(KEY) is None
    assert store.read(key_path(KEY)) is None


def test_newer_minor_is_read_without_the_fields_we_do_not_know(store):
    digest = store.put(store.private_folder(), "effect-plan", PLAN)
    manifest = json.loads(store.read(object_file(digest, MANIFEST)))
    manifest["metadata"]["effects"][0]["novelty"] = 3
    for schema, readable in (("effect-plan@1.7", True), ("effect-plan@1.0", False)):
        manifest["schema"] = schema
        parsed = Manifest.model_validate(manifest)
        if readable:
            assert read_metadata(parsed, EffectPlan) == PLAN
        else:
            with pytest.raises(ArtifactError, match="novelty"):
                read_metadata(parsed, EffectPlan)


def test_full_disk_is_a_storage_error_that_names_the_file():
    error = from_os_error(OSError(28, os.strerror(28), "/x/y"))
    assert isinstance(error, StorageError)
    assert "/x/y" in str(error)
    assert error.exit_code == 5


def _hold(root: str, ready) -> None:
    with FolderStore(Path(root)).lock("k"):
        ready.set()
        time.sleep(60)


def test_lock_dies_with_its_holder(folder_store):
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    holder = context.Process(target=_hold, args=(str(folder_store.root), ready))
    holder.start()
    assert ready.wait(30)
    os.kill(holder.pid, signal.SIGKILL)
    holder.join()
    with folder_store.lock("k"):
        pass


def test_what_processes_left_that_are_gone_is_swept_and_nothing_else(folder_store):
    """A number of a process says nothing of another machine's, another namespace's, or after another boot."""
    mine, here = folder_store.private_folder(), this_process()
    gone = [here._replace(pid=999999999), here._replace(boot="00000000")]
    at_work = [here._replace(host="elsewhere", pid=999999999), here._replace(namespace="0", pid=999999999)]
    for owner in (*gone, *at_work):
        (folder_store.root / "tmp" / f"{owner}-x").mkdir()
        (folder_store.root / "tmp" / f"{owner}-y").touch()
    folder_store.sweep_tmp()
    left = {p.name for p in (folder_store.root / "tmp").iterdir()}
    assert left == {mine.name, *(f"{owner}-{x}" for owner in at_work for x in "xy")}


def test_adopted_artifact_is_checked(store, tmp_path):
    digest = put(store)
    elsewhere = FolderStore(tmp_path / "other")
    manifest = store.manifest(digest)
    assert elsewhere.adopt(store.object_path(digest), manifest) == digest
    file = store.object_path(digest) / "raw" / "a.txt"
    file.chmod(0o644)
    file.write_text("hellO")
    with pytest.raises(ArtifactError, match="damaged"):
        FolderStore(tmp_path / "third").adopt(store.object_path(digest), manifest)


@pytest.mark.parametrize("place", ["gs://bucket/a", "s3://", "s3://me:secret@bucket/a"])
def test_a_place_that_is_no_store_is_a_configuration_error(place):
    with pytest.raises(ConfigurationError, match="s3://BUCKET/PREFIX"):
        open_store(place)


OTHER = digest_of({"another": "key"})


def test_records_that_are_swapped_are_nobodys(store):
    first, second = put(store, "1"), put(store, "2")
    store.commit(record(KEY, source=first))
    store.commit(record(OTHER, source=second).model_copy(update={"components": {"another": "key"}}))
    one, two = store.read(key_path(KEY)), store.read(key_path(OTHER))
    store.write(key_path(KEY), two)
    store.write(key_path(OTHER), one)
    assert store.lookup(KEY) is store.lookup(OTHER) is None
    assert len(store.names("quarantine")) == 2


def test_every_flipped_bit_of_a_record_is_found(folder_store):
    digest = put(folder_store)
    folder_store.commit(record(KEY, source=digest))
    good = folder_store.read(key_path(KEY))
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        with pytest.raises(ArtifactError):
            Record.decode(bytes(bad), KEY)
    assert Record.decode(good, KEY).outputs == {"source": digest}


def test_a_record_whose_components_give_another_key_is_refused():
    forged = record(KEY).model_copy(update={"components": {"seed": 2}})
    with pytest.raises(ArtifactError, match="its components do not give its key"):
        Record.decode(forged.encode(), KEY)


@pytest.mark.parametrize("data", [b"", b"[]", b"null", b'{"digest": 1}', b"[" * 100_000, b"\xff", b'{"digest": NaN}'])
def test_what_is_no_record_is_put_away_and_said(store, capsys, data):
    store.write(key_path(KEY), data)
    assert store.lookup(KEY) is None
    assert f"{key_path(KEY)}: not a record that this version writes" in capsys.readouterr().err
    digest = put(store)
    assert store.commit(record(KEY, source=digest)).outputs == {"source": digest}
    assert store.lookup(KEY) is not None


def test_junk_that_appears_before_a_commit_does_not_keep_it_from_being_one(store):
    digest = put(store)
    store.write(key_path(KEY), b"junk")
    store.commit(record(KEY, source=digest))
    assert store.lookup(KEY).outputs == {"source": digest}


def test_what_lies_where_a_store_keeps_something_else_is_moved_away(folder_store, capsys):
    (folder_store.root / "keys").mkdir()
    (folder_store.root / key_path(KEY)).mkdir()
    (folder_store.root / "work" / KEY.removeprefix("sha256:")).touch()
    (folder_store.root / "locks" / KEY.removeprefix("sha256:")).symlink_to("/nowhere/at/all")
    (folder_store.root / "locks" / "in-use").mkdir()
    digest = put(folder_store)
    folder_store.drop_object(digest)
    folder_store.object_path(digest).write_text("a file")
    with folder_store.shared(), folder_store.lock(KEY):
        assert folder_store.lookup(KEY) is None
        assert folder_store.work_folder(KEY).is_dir()
        put(folder_store)
        folder_store.commit(record(KEY, source=digest))
    assert folder_store.lookup(KEY) is not None
    assert capsys.readouterr().err.count("quarantine") == 4
    assert len(folder_store.names("quarantine")) == 5


def test_a_file_in_the_place_of_a_store_is_a_configuration_error(tmp_path):
    (tmp_path / "notes.txt").touch()
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "objects").touch()
    for place in ("notes.txt", "half", "notes.txt/store"):
        with pytest.raises(ConfigurationError, match="is a file where a store has a folder"):
            open_store(str(tmp_path / place))


@pytest.mark.parametrize(
    ("mask", "folder", "file"), [(0o022, 0o755, 0o444), (0o002, 0o775, 0o444), (0o077, 0o700, 0o400)]
)
def test_what_is_stored_has_the_rights_that_the_umask_leaves(tmp_path, mask, folder, file):
    before = os.umask(mask)
    try:
        store = FolderStore(tmp_path / "store")
        digest = put(store)
        store.commit(record(KEY, source=digest))
    finally:
        os.umask(before)
    rights = {p: p.stat().st_mode & 0o777 for p in (store.root / "objects", *store.root.rglob("objects/*"))}
    assert set(rights.values()) == {folder}
    assert (store.object_path(digest) / "raw" / "a.txt").stat().st_mode & 0o777 == file
    assert (store.root / key_path(KEY)).stat().st_mode & 0o777 == 0o666 & ~mask


@pytest.mark.parametrize(
    ("number", "code", "says"),
    [
        (errno.ENOSPC, 5, "no space left"), (errno.EDQUOT, 5, "no space left"), (errno.EROFS, 5, "read-only"),
        (errno.EACCES, 5, "no access"), (errno.EIO, 5, "the disk failed"), (errno.EMFILE, 75, "ulimit -n"),
        (errno.ENOTDIR, 5, "move away"), (errno.ESTALE, 75, "run again"), (errno.ENOMSG, 1, "/x/y"),
    ],
)  # fmt: skip
def test_errors_of_the_machine_are_told_apart(number, code, says):
    error = from_os_error(OSError(number, os.strerror(number), "/x/y"))
    assert (error.exit_code, says in str(error)) == (code, True)


def test_an_error_of_the_machine_is_found_behind_what_a_library_made_of_it():
    error = RuntimeError("cannot save")
    error.__cause__ = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/x")
    assert find_os_error(error).exit_code == 5
    assert find_os_error(RuntimeError("IoError: No space left on device (os error 28)")).exit_code == 5
    assert find_os_error(MemoryError()).exit_code == 75
    assert find_os_error(RuntimeError("a bug")) is None
