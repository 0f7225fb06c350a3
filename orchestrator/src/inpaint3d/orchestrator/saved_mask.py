"""The mask request that a person saved on the page: it lies in the run's folder, and the next run takes it."""

import dataclasses
import shlex
from pathlib import Path

from inpaint3d.orchestrator.options import RUNS, STORE, Places, SceneRequest

FILE = "mask.yaml"


def path_of(folder: Path) -> Path:
    """Where a run's folder has its mask request."""
    return folder / FILE


def use_saved(request: SceneRequest, folder: Path) -> SceneRequest:
    """The request with the run folder's mask request, where it has one and no other is given."""
    saved = path_of(folder)
    return dataclasses.replace(request, mask=saved) if request.mask is None and saved.is_file() else request


def command_to_edit(name: str, places: Places) -> str:
    """The command that serves the page of a run."""
    return shlex.join(["inpaint3d", "masks", "edit", name, *_list_options(places)])


def command_to_run(name: str, capture: str, places: Places, segmenter: tuple[Path, Path] | None) -> str:
    """The command that goes on with what was saved, and finds objects as the page did."""
    asked = ["--segmenter", *map(str, segmenter)] if segmenter else []
    return shlex.join(["inpaint3d", "run", capture, "--name", name, *asked, *_list_options(places)])


def _list_options(places: Places) -> list[str]:
    """The places that are not where they are by default."""
    store = [] if places.store == STORE else ["--store", places.store]
    return store + ([] if places.runs_dir == RUNS else ["--runs-dir", str(places.runs_dir)])
