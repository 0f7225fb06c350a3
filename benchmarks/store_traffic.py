"""What a run keeps, and what it would ask of a bucket: python -m benchmarks.store_traffic STORE NAME

Counted from the artifacts of the last run of NAME, by what `bucket.BucketStore` does. Written, an artifact is a
listing, a put for each file and one for its manifest; read, two gets of the manifest, a listing and a get for each
file. Files above 8 MiB go up in parts, which are not counted here.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.history import History


def main(place: str, name: str) -> None:
    store = FolderStore(Path(place))
    run = History(store).latest(name)
    rows: list[dict[str, Any]] = []
    for node in run.nodes:
        inputs: dict[str, Any] = node.components["inputs"]
        read = [store.manifest(d) for given in inputs.values() for d in ([given] if isinstance(given, str) else given)]
        written = [store.manifest(d) for d in node.outputs.values()]
        rows.append(
            {
                "node": node.node,
                "artifacts": len(written),
                "files": sum(len(m.files) for m in written),
                "written_mb": round(sum(f.size for m in written for f in m.files) / 1e6, 2),
                "read_mb": round(sum(f.size for m in read for f in m.files) / 1e6, 2),
                "gets": 2 + sum(2 + len(m.files) for m in read),  # the key before and after the work
                "puts": 1 + sum(1 + len(m.files) for m in written),
                "lists": len(read) + len(written),
            }
        )
    total = {k: round(sum(r[k] for r in rows), 2) for k in rows[0] if k != "node"}
    print(json.dumps({"preset": run.preset, "nodes": rows, "total": total}, indent=1))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", help="a store's folder")
    parser.add_argument("name", help="of a run")
    given = parser.parse_args()
    main(given.store, given.name)
