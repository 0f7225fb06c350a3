"""Random faults, counted: kills of a run at any moment, and damage to whatever a store keeps.

    python -m tests.faults.trials --kills 300 --corruptions 500 [--seed 0] [--out FILE.json [--add]]

After each kill everything visible has to be whole. After a few, the same command is run again: it has to succeed, with
the results of an undisturbed run, and no record may say that a run is still going on. After each corruption the store
may know less than before, but nothing else: what it answers under a key is what was computed, damage is found, and gc
removes nothing that a run needs. Exits with 1 where any of this failed once.
"""

import argparse
import collections
import contextlib
import itertools
import json
import random
import shutil
import sqlite3
import tempfile
import time
from pathlib import Path

from inpaint3d.contracts.errors import ArtifactError
from inpaint3d.contracts.kit.checkpoints import OPEN_SEAL, find_checkpoint, write_checkpoint
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.report import Machine, NodeRun, RunRecord
from inpaint3d.contracts.store import FolderStore, Record
from inpaint3d.contracts.store.workspace import remove
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.housekeeping import collect, find_damage
from inpaint3d.stages.pose_estimation.snapshots import restore_snapshot, save_snapshot
from tests.faults.kills import VICTIMS, kill_runs
from tests.faults.results import conclude_trials

RESULTS = 4
Counts = collections.Counter[str]


def build_store(folder: Path) -> dict[str, str]:
    """A store with results, the record of the run that made them, and a lock and a checkpoint; key -> output."""
    store = FolderStore(folder)
    made: dict[str, str] = {}
    for i in range(RESULTS):
        private = store.private_folder()
        (private / "raw").mkdir()
        (private / "raw" / "a.txt").write_text(f"result {i}")
        components = {"stage": "s@1", "seed": i}
        digest = store.put(private, "source", Source(name=f"a{i}", kind="folder"))
        result = Record(
            key=digest_of(components), stage="s@1", components=components, outputs={"x": digest}, provenance={},
            timings={},
        )  # fmt: skip
        made[store.commit(result).key] = digest
    nodes = tuple(
        NodeRun(node=f"n{i}", status="done", reason="", key=k, outputs={"x": d})
        for i, (k, d) in enumerate(made.items())
    )
    machine = Machine(processor="p", cores=1, memory_bytes=1, python="3")
    record = RunRecord(
        id="000001-a", name="a", pipeline="p", preset=None, externals={}, status="done", started="now",
        machine=machine, nodes=nodes,
    )  # fmt: skip
    History(store).save(record)
    with store.shared(), store.lock(next(iter(made))):
        pass
    return made


def list_targets(store: Path) -> dict[str, list[Path]]:
    """Kind -> files of a store that damage can be done to."""
    return {
        "object": [p for p in (store / "objects").rglob("*") if p.is_file()],
        "key": sorted((store / "keys").iterdir()),
        "record": sorted((store / "runs" / "a").iterdir()),
        "lock": sorted((store / "locks").iterdir()),
    }


def damage_file(path: Path, others: list[Path], rng: random.Random) -> str:
    """Do something to a file; what was done."""
    data = path.read_bytes()
    how = rng.choice(["flip", "cut", "junk", "folder", "link", "swap", "remove"])
    other = rng.choice(others).read_bytes()
    remove(path)
    if how == "flip" and data:
        bad = bytearray(data)
        bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
        path.write_bytes(bad)
    elif how == "cut" and data:
        path.write_bytes(data[: rng.randrange(len(data))])
    elif how == "folder":
        path.mkdir()
    elif how == "link":
        path.symlink_to("/nowhere/at/all")
    elif how == "swap":
        path.write_bytes(other)
    elif how != "remove":
        path.write_bytes(rng.randbytes(50))
    return how


def try_corruption(folder: Path, rng: random.Random) -> tuple[str, str | None]:
    """One corruption of a store of its own: its kind, and what went wrong, if anything did."""
    made = build_store(folder)
    kind, paths = rng.choice(sorted(list_targets(folder).items()))
    path = rng.choice(paths)
    before = path.read_bytes()
    how = damage_file(path, paths, rng)
    changed = not path.is_file() or path.read_bytes() != before
    fault = check_store(FolderStore(folder), made, kind, changed and how != "remove")
    return kind, fault and f"{kind} {how} {path.relative_to(folder)}: {fault}"


def check_store(store: FolderStore, made: dict[str, str], kind: str, changed: bool) -> str | None:
    """What a damaged store does wrong, or None."""
    if changed and kind != "lock" and not list(find_damage(store)):
        return "damage was not found"
    try:
        with store.shared(), store.lock(next(iter(made))):
            pass
        collect(store, keep=1, dry_run=True)
        if kind != "record":
            collect(store, keep=1, dry_run=False)
    except ArtifactError:
        if kind != "record":
            return "gc refuses though it knows what is needed"
    whole = 0
    for key, digest in made.items():
        record = store.lookup(key)
        if record is not None and record.outputs != {"x": digest}:
            return "a wrong result under a key"
        whole += record is not None
    lost = RESULTS - whole
    return None if lost <= (kind in ("object", "key")) else f"{lost} results lost"


def try_checkpoint(folder: Path, rng: random.Random) -> str | None:
    """One corruption of one of two generations: what is gone on from has to be the other."""
    path = folder / "checkpoint.safetensors"
    header = json.dumps({"__metadata__": OPEN_SEAL}).encode()
    for content in (b"1", b"2"):
        body = len(header).to_bytes(8, "little") + header + content * 100
        write_checkpoint(path, lambda staged, body=body: staged.write_bytes(body))
    before = path.read_bytes()
    how = damage_file(path, [path.with_name("checkpoint.previous.safetensors")], rng)
    found = find_checkpoint(path)
    if found is None:
        return f"checkpoint {how}: no generation left"
    harmless = how == "swap" or found.read_bytes() == before
    return None if harmless or found.read_bytes().endswith(b"1" * 100) else f"checkpoint {how}: gone on from damage"


def try_database(folder: Path, rng: random.Random) -> str | None:
    """One corruption of a database that is worked on, or of what was kept of it: it has to be as it was once kept."""
    path = folder / "capture.db"
    kept: list[bytes] = []
    for picture in ("a.jpg", "b.jpg"):
        with contextlib.closing(sqlite3.connect(path)) as database:
            database.execute("create table if not exists images (name text)")
            database.execute("insert into images values (?)", (picture,))
            database.commit()
        save_snapshot(path)
        kept.append(path.read_bytes())
    newest, previous = (folder / f"capture.db{part}.safetensors" for part in ("", ".previous"))
    target = rng.choice([path, newest, previous])
    before = target.read_bytes()
    how = damage_file(target, [p for p in (path, newest, previous) if p != target], rng)
    whole = target != newest or (target.is_file() and target.read_bytes() == before)
    if not restore_snapshot(path):
        return f"database {how}: nothing was left of it"
    wanted = kept[1] if whole else kept[0]
    return None if path.read_bytes() == wanted else f"database, {target.name} {how}: gone on from damage"


def carry_out(
    kills: int, corruptions: int, seed: int, folder: Path, minutes: float = float("inf")
) -> tuple[Counts, list[str]]:
    """All trials, or as many as there is time for: how many of each kind, and what went wrong."""
    end = time.monotonic() + 60 * minutes
    rng, counts, faults = random.Random(seed), Counts(), list[str]()

    def count(kind: str, fault: str | None) -> None:
        counts[kind] += 1
        faults.extend([fault] if fault else [])

    for i in range(corruptions):
        place = folder / f"store-{i}"
        place.mkdir()
        drawn = rng.random()
        if drawn < 0.15:
            count("corrupted checkpoint", try_checkpoint(place, rng))
        elif drawn < 0.3:
            count("corrupted database", try_database(place, rng))
        else:
            kind, fault = try_corruption(place, rng)
            count(f"corrupted {kind}", fault)
        shutil.rmtree(place)
    for i in itertools.count():
        hit = sum(counts[f"killed {whom}"] for whom in (*VICTIMS, "group"))
        if hit >= kills or time.monotonic() > end:
            break
        place = folder / f"run-{i}"
        place.mkdir()
        for whom, fault in kill_runs(place, rng):
            count(f"killed {whom}", fault)
        shutil.rmtree(place, ignore_errors=True)  # what a killed run had started may be about to end
    return counts, faults


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=300, help="that hit somebody; a run is killed several times")
    parser.add_argument("--corruptions", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="no kill is begun later")
    parser.add_argument("--out", type=Path, help="a JSON file with a section of each of these programs")
    parser.add_argument("--add", action="store_true", help="to what is in the file: many trials, an hour at a time")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        counts, faults = carry_out(given.kills, given.corruptions, given.seed, Path(folder), given.minutes)
    conclude_trials("kills and corruptions", given.seed, counts, faults, given.out, add=given.add)


if __name__ == "__main__":
    main()
