import json
import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest

from inpaint3d.contracts.artifacts import Effect, EffectPlan, Source
from inpaint3d.contracts.errors import ArtifactError, StorageError, from_os_error
from inpaint3d.contracts.manifest import MANIFEST
from inpaint3d.contracts.store import Record, Store

PLAN = EffectPlan(
    effects=(Effect(name="exposure", state="off", evidence={"ev": 0.01}, reason="still", cost_ratio=1.0),)
)


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "store")


def put(store, text="hello"):
    folder = store.private_folder()
    (folder / "raw").mkdir()
    (folder / "raw" / "a.txt").write_text(text)
    return store.put(folder, "source", Source(name="a", kind="folder"))


def record(key, **outputs):
    return Record(key=key, stage="s@0.1.0", components={}, outputs=outputs, provenance={}, timings={})


KEY = "sha256:" + "1" * 64


def test_what_is_put_can_be_opened_and_is_the_same(store):
    artifact = store.open(put(store), Source)
    assert artifact.metadata == Source(name="a", kind="folder")
    assert artifact.path("raw/a.txt").read_text() == "hello"
    with pytest.raises(ArtifactError, match="no file raw/b"):
        artifact.path("raw/b.txt")


def test_equal_content_has_one_digest_and_one_folder(store):
    assert put(store) == put(store)
    assert put(store) != put(store, "other")
    assert len(list((store.root / "objects").iterdir())) == 2
    assert list((store.root / "tmp").iterdir()) == []


def test_metadata_of_another_schema_is_refused(store):
    with pytest.raises(ArtifactError, match="wants metadata EffectPlan, got Source"):
        store.put(store.private_folder(), "effect-plan", Source(name="a", kind="folder"))


def test_a_file_that_metadata_names_must_be_there(store):
    from inpaint3d.contracts.artifacts import Capture, CapturedFrame

    frame = CapturedFrame(name="a", path="frames/a.png", width=2, height=2)
    with pytest.raises(ArtifactError, match=r"names frames/a\.png, which was not written"):
        store.put(store.private_folder(), "capture", Capture(layout="photos", ordered=False, frames=(frame,)))


@pytest.mark.parametrize("harm", ["flip", "truncate", "remove", "add", "manifest"])
def test_damage_is_found_quarantined_and_named(store, harm):
    digest = put(store)
    root = store.object_path(digest)
    file = root / "raw" / "a.txt"
    file.chmod(0o644)
    (root / MANIFEST).chmod(0o644)
    if harm == "flip":
        file.write_text("hellO")
    elif harm == "truncate":
        file.write_text("h")
    elif harm == "remove":
        file.unlink()
    elif harm == "add":
        (root / "extra").write_text("")
    else:
        (root / MANIFEST).write_text((root / MANIFEST).read_text().replace('"a"', '"b"'))
    assert store.damage(digest) is not None
    with pytest.raises(ArtifactError, match="quarantine"):
        store.open(digest, Source)
    assert not root.exists()
    assert len(list((store.root / "quarantine").iterdir())) == 1


def test_a_damaged_output_makes_its_key_unknown_again(store):
    digest = put(store)
    store.commit(record(KEY, source=digest))
    assert store.lookup(KEY) is not None
    file = store.object_path(digest) / "raw" / "a.txt"
    file.chmod(0o644)
    file.write_text("hellO")
    assert store.lookup(KEY) is None
    put(store)
    store.commit(record(KEY, source=digest))
    assert store.lookup(KEY).outputs == {"source": digest}


def test_first_commit_of_a_key_wins(store):
    first, second = put(store, "1"), put(store, "2")
    assert store.commit(record(KEY, source=first)).outputs == {"source": first}
    assert store.commit(record(KEY, source=second)).outputs == {"source": first}
    store.forget(KEY)
    assert store.commit(record(KEY, source=second)).outputs == {"source": second}


def test_torn_key_file_counts_as_nothing(store):
    store.record_path(KEY).write_text('{"key": "sha2')
    assert store.lookup(KEY) is None
    assert not store.record_path(KEY).exists()


def test_newer_minor_is_read_without_the_fields_we_do_not_know(store):
    digest = store.put(store.private_folder(), "effect-plan", PLAN)
    manifest = json.loads((store.object_path(digest) / MANIFEST).read_text())
    manifest["metadata"]["effects"][0]["novelty"] = 3
    for schema, readable in (("effect-plan@1.7", True), ("effect-plan@1.0", False)):
        manifest["schema"] = schema
        from inpaint3d.contracts.manifest import Manifest, read_metadata

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
    with Store(Path(root)).lock("k"):
        ready.set()
        time.sleep(60)


def test_lock_dies_with_its_holder(store):
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    holder = context.Process(target=_hold, args=(str(store.root), ready))
    holder.start()
    assert ready.wait(30)
    os.kill(holder.pid, signal.SIGKILL)
    holder.join()
    with store.lock("k"):
        pass


def test_private_folders_of_dead_processes_are_swept(store):
    mine = store.private_folder()
    dead = store.root / "tmp" / "999999999-x"
    dead.mkdir()
    store.sweep_tmp()
    assert mine.is_dir()
    assert not dead.exists()


def test_adopted_artifact_is_checked(store, tmp_path):
    digest = put(store)
    elsewhere = Store(tmp_path / "other")
    manifest = store.manifest(digest)
    assert elsewhere.adopt(store.object_path(digest), manifest) == digest
    file = store.object_path(digest) / "raw" / "a.txt"
    file.chmod(0o644)
    file.write_text("hellO")
    with pytest.raises(ArtifactError, match="damaged"):
        Store(tmp_path / "third").adopt(store.object_path(digest), manifest)
