"""`inpaint3d view` and `inpaint3d video`: the fields of a run, looked at by the stage that scores them."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.store import open_store
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.options import STORE, StorePath
from inpaint3d.orchestrator.stage_command import check_installed, run_stage_command

STAGE = "inpaint3d.stages.evaluation"
SHOWN = {
    "posed-capture": ("pose-estimation", "posed-capture"),
    "mask-set": ("mask-authoring", "mask-set"),
    "inpainted": ("joint-optimization", "radiance-field"),
    "original": ("nerf-pretraining", "radiance-field"),
}
"""What is looked at, as far as a run has it: option of the stage's command -> node and port."""


def add_to(app: typer.Typer) -> None:
    """Make the commands part of `inpaint3d`."""
    app.command()(view)
    app.command()(video)


def view(
    name: str,
    store: StorePath = STORE,
    port: Annotated[int, typer.Option(help="of this machine; default: any that is free")] = 0,
) -> None:
    """Serve a page to look around in the last run of NAME: before, after, depth, photos; until Ctrl-C."""
    _look("view", name, store, ["--port", str(port)])


def video(
    name: str,
    out: Annotated[Path | None, typer.Option(help="the film: .mp4, .webm or .avi; default: NAME.mp4")] = None,
    field: Annotated[Literal["inpainted", "original"], typer.Option(help="of which field")] = "inpainted",
    shown: Annotated[Literal["colour", "depth", "opacity"], typer.Option("--map", help="what of it")] = "colour",
    seconds: Annotated[float, typer.Option(min=0.1, help="how long")] = 8.0,
    rate: Annotated[float, typer.Option(min=1, help="pictures a second")] = 24.0,
    width: Annotated[int, typer.Option(min=16, help="pixels")] = 480,
    store: StorePath = STORE,
) -> None:
    """Write a film of the way along the cameras of the last run of NAME."""
    options = ["--out", str(out or Path(f"{name}.mp4")), "--field", field, "--map", shown]
    _look("video", name, store, [*options, "--seconds", str(seconds), "--rate", str(rate), "--width", str(width)])


def _look(command: str, name: str, place: str, options: list[str]) -> None:
    check_installed(STAGE)
    store = open_store(place)
    with store.shared():
        record = History(store).latest(name)
        outputs = {node.node: node.outputs for node in record.nodes}
        found = {option: outputs.get(node, {}).get(port) for option, (node, port) in SHOWN.items()}
        if found["posed-capture"] is None or not (found["inpainted"] or found["original"]):
            why = next((f": {node.error}" for node in record.nodes if node.error), "")
            raise BadInputError(f"{name} has no field to look at yet{why}; `inpaint3d run` it first")
        code = run_stage_command(STAGE, command, store, found, ["--title", name, *options])
    raise typer.Exit(code)
