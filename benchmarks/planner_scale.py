"""What planning costs when every result is there: seconds and memory for many scenes, on a store held in memory.

python -m benchmarks.planner_scale [SCENES ...] [--out FILE.json]
"""

import argparse
import json
import resource
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.provenance import commit

from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.cluster import Image
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore, Record, Store
from inpaint3d.orchestrator.configure import ConfiguredPipeline, Settings, configure
from inpaint3d.orchestrator.history import History, this_machine
from inpaint3d.orchestrator.plan import Planner, Selection, preview


class MemoryStore(FolderStore):
    """Documents in a dictionary; every artifact counts as whole. What is left is the planner's own cost."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.documents: dict[str, bytes] = {}
        self.requests = 0

    def read(self, path: str) -> bytes | None:
        self.requests += 1
        return self.documents.get(path)

    def create(self, path: str, data: bytes) -> bool:
        return self.documents.setdefault(path, data) is data

    def names(self, folder: str) -> list[str]:  # noqa: ARG002 - the store's signature
        self.requests += 1
        return []

    def is_whole(self, digest: str) -> bool:  # noqa: ARG002
        self.requests += 2  # a bucket's manifest and listing
        return True


def planner(configured: ConfiguredPipeline, store: Store, scene: int) -> Planner:
    stages = configured.pipeline.stages.values()
    images = {s.spec.image: Image(image="i", digest=digest_of(s.spec.image)) for s in stages}
    externals = {"capture": digest_of(scene)}
    return Planner(configured, store, History(store), f"scene-{scene}", externals, images=images)


def compute(configured: ConfiguredPipeline, store: Store, scene: int) -> None:
    """Commit a result under every key of a scene."""
    pipeline, planning = configured.pipeline, planner(configured, store, scene)
    for node in pipeline.order:
        task = planning.task(node)
        outputs = {port: digest_of([task.key, port]) for port in pipeline.stages[node].spec.outputs}
        stage = pipeline.stages[node].id
        record = Record(
            key=task.key, stage=stage, components=task.components, outputs=outputs, provenance={}, timings={}
        )
        planning.outputs[node] = store.commit(record).outputs


def measure(scenes: int) -> dict[str, float]:
    """The cost of planning so many scenes, all of whose results are there."""
    configured = configure(Pipeline(Path("pipeline.yaml")), Settings(compare=True), {"capture"})
    with tempfile.TemporaryDirectory() as folder:
        store = MemoryStore(Path(folder))
        for scene in range(scenes):
            compute(configured, store, scene)
        store.requests = 0
        start, cpu = time.perf_counter(), time.process_time()
        for scene in range(scenes):
            rows = preview(planner(configured, store, scene), Selection())
            if not {row.status for row in rows} <= {"cached", "left-out"}:
                raise RuntimeError(f"a result of scene {scene} was not found")
        return {
            "scenes": scenes,
            "nodes": len(configured.pipeline.order),
            "wall_s": round(time.perf_counter() - start, 2),
            "cpu_s": round(time.process_time() - cpu, 2),
            "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
            "store_requests": store.requests,
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=int, nargs="*", default=[1_000, 10_000], help="ascending")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    figures = {"plans": [measure(scenes) for scenes in given.scenes], "machine": this_machine().model_dump()}
    text = json.dumps(figures | commit(), indent=2) + "\n"
    sys.stdout.write(text)
    if given.out is not None:
        given.out.write_text(text)


if __name__ == "__main__":
    main()
