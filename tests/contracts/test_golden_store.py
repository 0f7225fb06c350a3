"""A store that an earlier version wrote is read by every later one: nothing in it is damaged, unknown or unneeded."""

import shutil

from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.housekeeping import collect, find_damage
from tests.contracts.make_golden import STORE


def test_every_result_of_it_is_found_and_kept(tmp_path):
    shutil.copytree(STORE, tmp_path / "store")
    store = FolderStore(tmp_path / "store")
    assert list(find_damage(store)) == []
    run = History(store).latest("a")
    assert run.status == "done"
    assert {node.key for node in run.nodes} == {record.key for record in store.records()}
    for i, node in enumerate(run.nodes):
        found = store.lookup(node.key)
        assert found is not None
        assert found.outputs == node.outputs
        assert (store.fetch(node.outputs["x"]) / "raw" / "a.txt").read_text() == f"result {i}"
    before = {path for path in store.root.rglob("*") if path.is_file() and "locks" not in path.parts}
    collect(store, keep=1, dry_run=False)
    assert before == {path for path in store.root.rglob("*") if path.is_file() and "locks" not in path.parts}
    assert len(before) == 13, "of four results two files of the artifact and a record, and the run's record"
