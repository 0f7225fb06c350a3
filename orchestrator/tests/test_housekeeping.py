import pytest

from inpaint3d.contracts.errors import RetryableError
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.store import FolderStore, Record
from inpaint3d.orchestrator.housekeeping import collect

COMPONENTS = {"seed": 1}
KEY = digest_of(COMPONENTS)


def committed(store):
    """A result that no run's record names: as one that a stage has just committed."""
    folder = store.private_folder()
    (folder / "a.txt").write_text("a")
    digest = store.put(folder, "source", Source(name="x", kind="folder"))
    store.commit(Record(key=KEY, stage="s@1", components=COMPONENTS, outputs={"x": digest}, provenance={}, timings={}))
    return digest


def test_nothing_goes_while_the_store_is_in_use(tmp_path):
    store = FolderStore(tmp_path)
    digest, work = committed(store), store.work_folder(KEY)
    with FolderStore(tmp_path).shared(), store.shared(), pytest.raises(RetryableError, match="a run is using"):
        collect(store, keep=1, dry_run=False)
    assert store.lookup(KEY) is not None
    assert work.is_dir()
    collect(store, keep=1, dry_run=False)
    assert not store.is_present(digest)
    assert store.lookup(KEY) is None
    assert not work.exists()


def test_the_store_is_free_again_when_its_user_is_gone(tmp_path):
    store = FolderStore(tmp_path)
    with store.shared():
        pass
    with store.exclusive():
        pass
    collect(store, keep=1, dry_run=True)
