"""Views that a person, or their 2D tool, paints in: asked for from a run, and taken back into the store."""

import shutil
from pathlib import Path

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.artifacts import CleanPlates, PaintedView, PaintedViews
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES
from inpaint3d.contracts.models.base import Closed, Digest, FrameName
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.store import Store
from inpaint3d.report.page import render

REQUEST = "paint.yaml"
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
    for canvas in canvases:
        for place, path in (
            (f"{canvas.name}.png", canvas.picture),
            (f"{ASKED}/{canvas.name}.png", canvas.picture),
            (f"{MASKS}/{canvas.name}.png", canvas.mask),
            (f"{CUTOUTS}/{canvas.name}.png", canvas.cutout),
        ):
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
            (folder / place).write_bytes(artifact.path(path).read_bytes())
    names = [canvas.name for canvas in canvases]
    lines = ["# What `inpaint3d paint ask` exported; --painted reads it.", f"run: {run!r}", "views:"]
    (folder / REQUEST).write_text("\n".join([*lines, *(f"  - {name!r}" for name in names)]) + "\n")
    (folder / "index.html").write_text(render("inpaint3d.orchestrator", "paint.html.j2", run=run, names=names))
    return names


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
