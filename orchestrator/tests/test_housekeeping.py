from inpaint3d.contracts.store import Store
from inpaint3d.orchestrator.housekeeping import collect

KEYS = ["sha256:" + c * 64 for c in "ab"]


def test_checkpoints_of_a_running_stage_are_kept(tmp_path):
    store = Store(tmp_path)
    running, left = (store.work_folder(k) for k in KEYS)
    with store.lock(KEYS[0]):
        collect(store, keep=1, dry_run=False)
        assert running.is_dir()
        assert not left.exists()
    collect(store, keep=1, dry_run=False)
    assert not running.exists()
