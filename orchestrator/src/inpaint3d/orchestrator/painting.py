"""Views that a person, or their 2D tool, paints in: asked for from a run, and taken back into the store."""

import shutil
from pathlib import Path

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.artifacts import CleanPlates, PaintedView, PaintedViews
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES
from inpaint3d.contracts.models.base import Closed, Digest, FrameName
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.report.page import render

REQUEST = "paint.yaml"
PAINTED = "painted"
"""Where the folder of a run has the pictures that were dropped on its page."""
ASKED, MASKS, CUTOUTS = "asked", "masks", "cutouts"


class PaintRequest(Closed):
    """What was asked: `paint.yaml`, beside the pictures."""

    run: str
    views: tuple[FrameName, ...]


def ask(store: Store, run: str, plates: Digest | None, folder: Path) -> list[str]:
    """Write the views in which a run's made-up surfaces are decided, to be painted in; returns their names.

    ConfigurationError where the run has no plates, made nothing up, or the folder has something in it.
    """
    if plates is None:
        raise ConfigurationError(f"{run} has no plates to paint in; run it again with --want plate-export")
    if folder.exists() and any(folder.iterdir()):
        raise ConfigurationError(f"{folder} is not empty; name a new folder with --out")
    artifact = store.open(plates, CleanPlates)
    if not (canvases := artifact.metadata.canvases):
        raise ConfigurationError(f"nothing is made up in {run}: other photos show all of its hole")
    _export(artifact, run, folder)
    for canvas in canvases:
        (folder / f"{canvas.name}.png").write_bytes(artifact.path(canvas.picture).read_bytes())
    names = [canvas.name for canvas in canvases]
    (folder / "index.html").write_text(render("inpaint3d.orchestrator", "paint.html.j2", run=run, names=names))
    return names


def offer(store: Store, run: str, plates: Digest | None, folder: Path) -> Path | None:
    """The folder for a page on which painted pictures are dropped; None where nothing was made up.

    It has what was asked for, and no picture yet. One that has a painted picture is left as it is.
    """
    if plates is None or not (artifact := store.open(plates, CleanPlates)).metadata.canvases:
        return None
    if folder.is_dir() and any(path.suffix.lower() in PICTURE_SUFFIXES for path in folder.iterdir()):
        return folder
    for part in (ASKED, MASKS, CUTOUTS):
        shutil.rmtree(folder / part, ignore_errors=True)
    _export(artifact, run, folder)
    return folder


def _export(plates: Artifact[CleanPlates], run: str, folder: Path) -> None:
    """What is asked for, beside which painted pictures are to lie."""
    canvases = plates.metadata.canvases
    for canvas in canvases:
        for part, path in ((ASKED, canvas.picture), (MASKS, canvas.mask), (CUTOUTS, canvas.cutout)):
            (folder / part).mkdir(parents=True, exist_ok=True)
            (folder / part / f"{canvas.name}.png").write_bytes(plates.path(path).read_bytes())
    lines = ["# What `inpaint3d paint ask` exported; --painted reads it.", f"run: {run!r}", "views:"]
    (folder / REQUEST).write_text("\n".join([*lines, *(f"  - {canvas.name!r}" for canvas in canvases)]) + "\n")


def take_painted(store: Store, folder: Path) -> Digest:
    """A folder that `ask` wrote, painted in; its pixels are looked at by the stage that reads them.

    BadInputError names the picture that is not one of those asked for, or that is as it was.
    """
    if not (folder / REQUEST).is_file():
        raise BadInputError(f"{folder} has no {REQUEST}; give the folder that `inpaint3d paint ask` wrote")
    asked, _ = load_document(folder / REQUEST, PaintRequest)
    pictures = _find_pictures(folder, asked.views)
    target = store.private_folder()
    views: list[PaintedView] = []
    for name, path in pictures.items():
        before = folder / ASKED / f"{name}.png"
        if path.read_bytes() == before.read_bytes():
            raise BadInputError(f"{path} is as it was exported; paint in it, or remove it from the folder")
        view = PaintedView(
            name=name,
            picture=f"pictures/{name}{path.suffix.lower()}",
            mask=f"masks/{name}.png",
            asked=f"asked/{name}.png",
        )
        for source, place in ((path, view.picture), (folder / MASKS / f"{name}.png", view.mask), (before, view.asked)):
            (target / str(place)).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target / str(place))
        views.append(view)
    return store.put(target, "painted-views", PaintedViews(views=tuple(views)))


def _find_pictures(folder: Path, names: tuple[str, ...]) -> dict[str, Path]:
    """The painted pictures by view, in the order in which they were asked for."""
    found: dict[str, Path] = {}
    for path in sorted(p for p in folder.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES):
        if path.stem not in names:
            raise BadInputError(f"{path} is none of the views that were asked for: {', '.join(names)}; rename it")
        if path.stem in found:
            raise BadInputError(f"{found[path.stem].name} and {path.name} are of one view; remove one from {folder}")
        found[path.stem] = path
    if not found:
        raise BadInputError(f"{folder} has no painted picture; there should be one of {', '.join(names)}")
    return {name: found[name] for name in names if name in found}
