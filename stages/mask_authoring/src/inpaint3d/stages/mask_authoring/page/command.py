"""The stage's command `edit`: serves the page until it is interrupted."""

import argparse
import contextlib
from pathlib import Path
from typing import Any, NoReturn

import cv2

from inpaint3d.contracts.kit.commands import carry_out_confined
from inpaint3d.contracts.kit.page_server import PageServer
from inpaint3d.contracts.models.artifacts import Capture, PosedCapture, RadianceFieldArtifact, Segmenter
from inpaint3d.contracts.store import Artifact, open_store
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.page.editor import Editor
from inpaint3d.stages.mask_authoring.page.painted import PaintedFolder
from inpaint3d.stages.mask_authoring.page.pictures import open_subject
from inpaint3d.stages.mask_authoring.sam import load_segmenter

THREADS = 1  # what the stage itself has, so that the page shows the masks that it will make


def edit(arguments: list[str]) -> NoReturn:
    """Serve the page, and exit with a code of `inpaint3d.contracts.errors`."""
    options = _parse(arguments)
    carry_out_confined(lambda: _serve(options), with_parent=options.die_with_parent)


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m inpaint3d.stages.mask_authoring edit", description=__doc__)
    parser.add_argument("--store", required=True, help="a folder, or s3://BUCKET/PREFIX")
    parser.add_argument("--capture", required=True, help="digest of the capture")
    parser.add_argument("--posed-capture", help="digest; without one pictures are shown as they are")
    parser.add_argument("--radiance-field", help="digest; without one masks are not carried")
    parser.add_argument("--segmenter", help="digest; without one GrabCut finds what is pointed at")
    parser.add_argument("--save", type=Path, required=True, help="file for the mask request")
    parser.add_argument("--painted", type=Path, help="folder with views to paint in; without it none can be dropped")
    parser.add_argument("--title", default="", help="what is edited")
    parser.add_argument("--then", default="", help="the command that goes on with what was saved")
    parser.add_argument("--port", type=int, default=0, help="default: any that is free")
    parser.add_argument("--die-with-parent", action="store_true", help="end when whoever started this ends")
    return parser.parse_args(arguments)


def _serve(options: argparse.Namespace) -> None:
    cv2.setNumThreads(THREADS)
    store = open_store(options.store)

    def open_optional(digest: str | None, model: Any) -> Artifact[Any] | None:
        return store.open(digest, model) if digest else None

    segmenter = open_optional(options.segmenter, Segmenter)
    subject = open_subject(
        store.open(options.capture, Capture),
        open_optional(options.posed_capture, PosedCapture),
        open_optional(options.radiance_field, RadianceFieldArtifact),
        load_segmenter(segmenter, THREADS) if segmenter else None,
    )
    painted = PaintedFolder(options.painted) if options.painted else None
    editor = Editor(options.title, subject, options.save, options.then, Config(), painted=painted)
    put = editor.put if painted else None
    with contextlib.closing(editor), PageServer(editor.get, editor.post, options.port, put=put) as server:
        server.announce_and_serve()
