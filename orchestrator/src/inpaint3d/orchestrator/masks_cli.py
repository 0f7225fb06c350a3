"""`inpaint3d masks`: a page on which a person points at what is to go."""

from pathlib import Path
from typing import Annotated

import typer

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.store import Store, open_store
from inpaint3d.orchestrator import painting, saved_mask
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.intake import name_run, take_segmenter
from inpaint3d.orchestrator.options import Name, Places, Request, Segmenter, with_options
from inpaint3d.orchestrator.plan import Selection
from inpaint3d.orchestrator.progress import choose_display
from inpaint3d.orchestrator.request import ConfiguredRequest
from inpaint3d.orchestrator.run import Scheduler
from inpaint3d.orchestrator.run_folder import check_capture, own_folder
from inpaint3d.orchestrator.stage_command import check_installed, run_stage_command

masks_app = typer.Typer(no_args_is_help=True, help="What is to go, pointed at on a page.")

STAGE = "inpaint3d.stages.mask_authoring"
INGEST = "capture-ingest"
SHOWN = {
    "capture": (INGEST, "capture"),
    "posed-capture": ("pose-estimation", "posed-capture"),
    "radiance-field": ("nerf-pretraining", "radiance-field"),
}
"""What the page shows, as far as a run has it: option of the stage's command -> node and port."""


@masks_app.callback()
def _masks() -> None:
    """What is to go, pointed at on a page."""


@masks_app.command()
@with_options
def edit(
    capture: Annotated[str, typer.Argument(help="name of a run, or the capture that it is of")],
    places: Places,
    name: Name = None,
    segmenter: Segmenter = None,
    port: Annotated[int, typer.Option(help="of this machine; default: any that is free")] = 0,
) -> None:
    """Serve a page on which a person points at what is to go, and sees the masks in every view; until Ctrl-C.

    Before a run has cameras and a field, masks are shown on the picture pointed at. What is saved is the mask request
    of the next `run` of the name. Where plates were made, views that were painted in are dropped there too. The page
    is a process of this environment, also where stages run in containers.
    """
    check_installed(STAGE)
    store = open_store(places.store)
    with store.shared():
        network = take_segmenter(store, *segmenter) if segmenter else None
        record = _find_run(store, capture, places, name)
        outputs = {node.node: node.outputs for node in record.nodes}
        shown = {option: outputs.get(node, {}).get(output) for option, (node, output) in SHOWN.items()}
        if shown["capture"] is None:
            why = next((f": {node.error}" for node in record.nodes if node.error), "")
            raise BadInputError(f"{record.name} has no pictures yet{why}; `inpaint3d run` it first")
        photos = capture if Path(capture).exists() else "PHOTOS"
        then = saved_mask.command_to_run(record.name, photos, places, segmenter)
        target = str(saved_mask.path_of(places.runs_dir / record.name))
        options = ["--save", target, "--title", record.name, "--then", then, "--port", str(port)]
        plates = outputs.get("plate-export", {}).get("clean-plates")
        if painted := painting.offer(store, record.name, plates, places.runs_dir / record.name / painting.PAINTED):
            options += ["--painted", str(painted)]
        code = run_stage_command(STAGE, "edit", store, shown | {"segmenter": network}, options)
    raise typer.Exit(code)


def _find_run(store: Store, capture: str, places: Places, name: str | None) -> RunRecord:
    """The last run of a name or of a capture; of a capture that was never run, its pictures are read."""
    path = Path(capture)
    if not path.exists():
        return History(store).latest(capture)
    selection = Selection(until=INGEST)
    planner = ConfiguredRequest(Request(), selection).planner(store, path, name_run(path, name))
    check_capture(planner, replace=False)
    for record in planner.history.of(planner.name):
        return record
    folder = places.runs_dir / planner.name
    with own_folder(folder):
        return Scheduler(planner, selection, choose_display("auto", planner.pipeline.order), folder).run()
