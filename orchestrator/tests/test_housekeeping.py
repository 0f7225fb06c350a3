import json
import os
import time

import pytest

from inpaint3d.contracts.errors import ArtifactError, RetryableError
from inpaint3d.contracts.kit.code import code_path, save_listing
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.report import Machine, NodeRun, RunRecord
from inpaint3d.contracts.store import FolderStore, Record, key_path, this_process
from inpaint3d.contracts.store.owner import Owner
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.housekeeping import collect, find_damage
from inpaint3d.orchestrator.provenance import find_unproved

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
    digest = committed(store)
    for use in (store.shared, store.exclusive):
        with use():
            pass
        collect(store, keep=1, dry_run=True)
        assert store.is_present(digest), "a dry run takes nothing away"
    collect(store, keep=1, dry_run=False)
    assert not store.is_present(digest)


MACHINE = Machine(processor="p", cores=1, memory_bytes=1, python="3")


def write_run(store, *, sequence=1, status="done", day="20260101", keys=(), outputs=(), name="a", **more):
    """A run's record as a run writes it."""
    nodes = tuple(
        NodeRun(node=f"n{i}", status="done", reason="", key=key, outputs={"x": digest})
        for i, (key, digest) in enumerate(zip(keys, outputs, strict=True))
    )
    record = RunRecord(
        id=f"{sequence:06d}-{day}T000000-aaaa", name=name, pipeline="p", preset=None, externals={}, status=status,
        started=day, machine=MACHINE, nodes=nodes, **more,
    )  # fmt: skip
    History(store).save(record)
    return f"runs/{name}/{record.id}.json"


@pytest.fixture
def kept(tmp_path):
    """A store with one result, and the record of the run that made it."""
    store = FolderStore(tmp_path / "store")
    digest = committed(store)
    return store, digest, write_run(store, keys=[KEY], outputs=[digest])


def cut(data):
    return data[: len(data) // 2]


def mistyped(data):
    return seal(json.loads(data) | {"externals": []})


def flip(data):
    """Another key in the place of the one that the run has."""
    return data.replace(KEY.encode(), digest_of("another").encode())


def seal(body):
    """A record's bytes as a version writes them that has other fields."""
    body.pop("digest")
    return json.dumps({"digest": digest_of(body), **body}).encode()


@pytest.mark.parametrize(
    "spoil", [cut, mistyped, flip, lambda _: b"", lambda _: b"[]", lambda _: b"\xff", lambda _: b"null"]
)
def test_gc_removes_nothing_while_a_runs_record_cannot_be_read(kept, spoil):
    store, digest, path = kept
    store.write(path, spoil(store.read(path)))
    for dry_run in (True, False):
        with pytest.raises(ArtifactError, match=f"{path} cannot be read .*nothing was removed; restore it"):
            collect(store, keep=1, dry_run=dry_run)
    assert store.is_whole(digest)
    assert store.lookup(KEY) is not None
    (damage,) = find_damage(store)
    assert path in damage.what
    assert damage.mend is None, "what it needed cannot be known again"
    store.remove(path)
    assert collect(store, keep=1, dry_run=False)[1] == 1


def test_a_folder_or_a_file_in_the_place_of_records_is_no_record(kept):
    store, digest, path = kept
    store.remove(path)
    (store.root / path).mkdir()
    (store.root / "runs" / "b").write_text("a file")
    for stray in (path, "runs/b"):
        with pytest.raises(ArtifactError, match=f"{stray} cannot be read"):
            collect(store, keep=1, dry_run=False)
        store.remove(stray)
    assert store.is_whole(digest)


def test_of_a_newer_versions_record_all_that_it_names_is_kept(kept):
    store, digest, path = kept
    other = store.put(store.private_folder(), "source", Source(name="newer", kind="folder"))
    newer = json.loads(store.read(path)) | {"previews": {"a": [other]}, "status": "paused"}
    store.write(path, seal(newer))
    write_run(store, sequence=2)
    collect(store, keep=1, dry_run=False)
    assert store.is_whole(digest)
    assert store.is_whole(other)
    assert store.lookup(KEY) is not None
    assert list(find_damage(store)) == []


def test_what_a_submission_names_is_kept_before_any_record_does(kept):
    store, digest, path = kept
    store.remove(path)
    store.write("submissions/test.json", json.dumps({"scenes": [{"externals": {"capture": digest}}]}).encode())
    collect(store, keep=1, dry_run=False)
    assert store.is_whole(digest)


def test_runs_come_in_the_order_of_their_numbers_whatever_the_clock_said(kept):
    store, digest, _ = kept
    history = History(store)
    write_run(store, sequence=2, day="29991231", status="failed")
    assert history.new_id("a").startswith("000003-")
    write_run(store, sequence=3, day="20200101", keys=[KEY], outputs=[digest])
    assert [r.started for r in history.of("a")] == ["20200101", "29991231", "20260101"]
    assert history.latest("a").started == "20200101"
    assert history.new_id("another").startswith("000001-")
    assert History(store).new_id("a") > "000003-"


def test_the_record_of_a_run_that_was_killed_is_closed_and_no_others(kept):
    store, _, _ = kept
    here = this_process()
    for sequence, owner in ((2, here), (3, here._replace(pid=999999999)), (4, here._replace(host="elsewhere"))):
        write_run(store, sequence=sequence, status="running", process=str(owner))
    History(store).close_killed("a")
    assert [r.status for r in History(store).of("a")] == ["running", "stopped", "running", "done"]


def test_verify_finds_what_is_wrong_with_keys_and_mends_it(kept):
    store, digest, _ = kept
    other = digest_of({"other": 1})
    store.write(key_path(other), store.read(key_path(KEY)))
    store.write("code/" + "0" * 64 + ".json", b"{}")
    assert sorted(d.what.partition(": ")[2] for d in find_damage(store)) == ["", f"the record of another key, {KEY}"]
    store.drop_object(digest)
    whats = [d.what for d in find_damage(store)]
    assert len(whats) == 3
    assert any(f"its x {digest} is gone" in what for what in whats)
    for damage in find_damage(store):
        damage.mend()
    assert list(find_damage(store)) == []
    assert store.lookup(KEY) is store.lookup(other) is None


def test_checkpoints_that_another_machine_may_be_at_work_on_stay(tmp_path):
    store = FolderStore(tmp_path)
    mine, theirs = store.work_folder(KEY), store.work_folder(digest_of(1))
    theirs.with_suffix(".owner").write_text(str(this_process()._replace(host="elsewhere")))
    collect(store, keep=1, dry_run=False)
    assert not mine.exists()
    assert theirs.is_dir()


def proved(store):
    """A run of two nodes, the second of which reads what the first has written, and its record."""
    folder = store.private_folder()
    (folder / "photo.txt").write_text("photo")
    photo = store.put(folder, "source", Source(name="photo", kind="folder"))
    nodes, given = [], photo
    for i in range(2):
        folder = store.private_folder()
        (folder / "a.txt").write_text(str(i))
        digest = store.put(folder, "source", Source(name=str(i), kind="folder"))
        code = save_listing(store, {"python": "3", "file": str(i)})
        components = {"seed": i, "inputs": {"x": given}, "code": code}
        key = digest_of(components)
        store.commit(
            Record(key=key, stage="s@1", components=components, outputs={"y": digest}, provenance={}, timings={})
        )
        nodes.append(
            NodeRun(node=f"n{i}", status="done", reason="", key=key, components=components, outputs={"y": digest})
        )
        given = digest
    return RunRecord(
        id="000001-a", name="a", pipeline="p", preset=None, externals={"capture": photo}, status="done", started="now",
        machine=Machine(processor="p", cores=1, memory_bytes=1, python="3"), nodes=tuple(nodes),
    )  # fmt: skip


def test_a_run_is_proved_back_to_its_photos(tmp_path):
    store = FolderStore(tmp_path)
    assert list(find_unproved(store, proved(store))) == []


def _change(path, old, new):
    path.chmod(0o644)
    path.write_text(path.read_text().replace(old, new))


def _swap_keys(store, record):
    first, second = (store.root / key_path(n.key) for n in record.nodes)
    data = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(data)


@pytest.mark.parametrize(
    ("tamper", "says"),
    [
        (
            lambda s, r: _change(s.object_path(r.externals["capture"]) / "photo.txt", "photo", "phoxo"),
            "external capture",
        ),
        (lambda s, r: _change(s.object_path(r.nodes[1].outputs["y"]) / "a.txt", "1", "2"), "n1: its y"),
        (lambda s, r: _change(s.root / key_path(r.nodes[0].key), '"seed":0', '"seed":7'), "n0: its key record"),
        (_swap_keys, "n0: its key record"),
        (lambda s, r: (s.root / key_path(r.nodes[1].key)).unlink(), "n1: its key record"),
        (
            lambda s, r: _change(s.root / code_path(r.nodes[0].components["code"]), "3", "4"),
            "n0: the listing of its code",
        ),
    ],
)
def test_what_was_tampered_with_is_named(tmp_path, tamper, says):
    store = FolderStore(tmp_path)
    record = proved(store)
    tamper(store, record)
    assert any(found.startswith(says) for found in find_unproved(store, record))


def test_a_record_that_was_changed_is_unproved(tmp_path):
    store = FolderStore(tmp_path)
    record = proved(store)
    one, two = record.nodes
    other = record.model_copy(update={"nodes": (one.model_copy(update={"outputs": two.outputs}), two)})
    assert any("names other results" in found for found in find_unproved(store, other))
    without = record.model_copy(update={"nodes": (two,)})
    assert any("nothing that this run made" in found for found in find_unproved(store, without))
    moved = one.model_copy(update={"components": {**one.components, "seed": 9}})
    assert any("does not follow" in f for f in find_unproved(store, record.model_copy(update={"nodes": (moved, two)})))


def test_what_another_machine_left_is_swept_after_its_lease(tmp_path):
    store = FolderStore(tmp_path)
    theirs = Owner("othehost", "boot", "space", 1)
    for path in (store.root / "tmp" / f"{theirs}-a", store.work_folder(KEY)):
        path.mkdir(exist_ok=True)
        (path / "part").write_text("a")
    store.work_folder(KEY).with_suffix(".owner").write_text(str(theirs))

    def age(days):
        then = time.time() - days * 24 * 3600
        for path in store.root.rglob("*"):
            os.utime(path, (then, then))

    age(6)
    store.sweep_tmp()
    assert [*(store.root / "tmp").iterdir()] != []
    assert store.list_litter() == []
    age(8)
    store.sweep_tmp()
    assert [*(store.root / "tmp").iterdir()] == []
    assert [p.name for p in store.list_litter()] == [
        store.work_folder(KEY).name,
        f"{store.work_folder(KEY).name}.owner",
    ]
