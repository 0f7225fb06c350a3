"""How long a person at the mask page waits: for the mask on the view, on the nearest views, and on all.

    python -m benchmarks.mask_page RUN [--store PLACE] [--request examples/demo/mask.yaml]

RUN is a run that has a field. Processor seconds of one thread and seconds by the clock, best of two, without the
browser's share (some 30 ms). Writes `benchmarks/results/mask_page.json`.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2
from benchmarks.provenance import REPOSITORY, commit

from inpaint3d.contracts.models.artifacts import Capture, MaskRequest, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.store import open_store
from inpaint3d.orchestrator.history import History, this_machine
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.page.carrying import Carried, Carrier
from inpaint3d.stages.mask_authoring.page.masks import mask_at_once
from inpaint3d.stages.mask_authoring.page.pictures import Subject, open_subject

RESULTS = REPOSITORY / "benchmarks" / "results" / "mask_page.json"
REPEATS = 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run")
    parser.add_argument("--store", default=".inpaint3d/store")
    parser.add_argument("--request", type=Path, default=REPOSITORY / "examples/demo/mask.yaml")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    subject = open_run(given.store, given.run)
    request, _ = load_document(given.request, MaskRequest)
    view = request.mask.view
    figures = {"on the view": measure(lambda: mask_at_once(request.mask, subject, view, Config(), 0))}
    figures |= measure_carrying(subject, request)
    for name, (cpu, wall) in figures.items():
        print(f"| {name} | {cpu:.1f} | {wall:.1f} |")
    machine = this_machine()
    document = {"views": len(subject.names()), "machine": machine.model_dump(), "commit": commit(), "seconds": figures}
    RESULTS.write_text(json.dumps(document, indent=2) + "\n")


def open_run(store_place: str, run: str) -> Subject:
    store = open_store(store_place)
    outputs = {port: digest for node in History(store).latest(run).nodes[:4] for port, digest in node.outputs.items()}
    return open_subject(
        store.open(outputs["capture"], Capture),
        store.open(outputs["posed-capture"], PosedCapture),
        store.open(outputs["radiance-field"], RadianceFieldArtifact),
    )


def measure(work: Callable[[], object]) -> tuple[float, float]:
    """Processor and clock seconds, best of some."""
    times: list[tuple[float, float]] = []
    for _ in range(REPEATS):
        cpu, wall = time.process_time(), time.monotonic()
        work()
        times.append((time.process_time() - cpu, time.monotonic() - wall))
    return min(times)


def measure_carrying(subject: Subject, request: MaskRequest) -> dict[str, tuple[float, float]]:
    """From the question to the first outlines, and to the last."""
    carrier = Carrier(subject, Config(), 0)
    carrier.start()

    def carry(until: Callable[[Carried], bool]) -> None:
        carrier.ask(request)
        while not until(carrier.state()):
            time.sleep(0.01)

    first = measure(lambda: carry(lambda state: bool(state.outlines)))
    whole = measure(lambda: carry(lambda state: state.complete))
    shown = len(subject.names())
    carrier.close()
    return {"on the 8 nearest views": first, f"on all {shown} views": whole}


if __name__ == "__main__":
    main()
