"""`inpaint3d paint`: a person's brush in the loop."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from inpaint3d.contracts.store import open_store
from inpaint3d.orchestrator import painting
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.options import STORE, StorePath

paint_app = typer.Typer(no_args_is_help=True, help="Views to paint in, for `run --painted`.")


@paint_app.callback()
def _paint() -> None:
    """Views to paint in, for `run --painted`."""


@paint_app.command()
def ask(
    run: Annotated[str, typer.Argument(help="name of a run that has plates")],
    out: Annotated[Path, typer.Option(help="a new folder")],
    store: StorePath = STORE,
) -> None:
    """Write the views in which what no photo shows was made up, with masks and a page that says what to do."""
    opened = open_store(store)
    outputs = {node.node: node.outputs for node in History(opened).latest(run).nodes}
    names = painting.ask(opened, run, outputs.get("plate-export", {}).get("clean-plates"), out)
    sys.stdout.write(f"{out}/index.html says what to do with {', '.join(names)}\n")
