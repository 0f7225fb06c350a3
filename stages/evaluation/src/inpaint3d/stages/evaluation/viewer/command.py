"""The stage's commands `view`, which serves the viewer until it is interrupted, and `video`, which writes a film."""

import argparse
import sys
from pathlib import Path
from typing import NoReturn

import torch

from inpaint3d.contracts.kit.commands import carry_out_confined
from inpaint3d.contracts.kit.page_server import PageServer
from inpaint3d.contracts.models.artifacts import MaskSet, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.store import Store, open_store
from inpaint3d.radiance.io import load_field
from inpaint3d.scene.capture_io import load_posed
from inpaint3d.stages.evaluation.photos import read_masks
from inpaint3d.stages.evaluation.viewer.film import interpolate, write_film
from inpaint3d.stages.evaluation.viewer.pages import ViewerPages
from inpaint3d.stages.evaluation.viewer.scene import MAPS, ViewerScene

FIELDS = ("inpainted", "original")


def look(arguments: list[str]) -> NoReturn:
    """Do what the command line says, and exit with a code of `inpaint3d.contracts.errors`."""
    options = _parse(arguments)
    carry_out_confined(lambda: _carry_out(options), with_parent=options.die_with_parent)


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m inpaint3d.stages.evaluation", description=__doc__)
    parser.add_argument("command", choices=["view", "video"])
    parser.add_argument("--store", required=True, help="a folder, or s3://BUCKET/PREFIX")
    parser.add_argument("--posed-capture", required=True, help="digest")
    parser.add_argument("--mask-set", help="digest")
    for name in FIELDS:
        parser.add_argument(f"--{name}", help="digest of a radiance field")
    parser.add_argument("--title", default="", help="what is looked at")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--port", type=int, default=0, help="view: default: any that is free")
    parser.add_argument("--out", type=Path, help="video: the file")
    parser.add_argument("--field", choices=FIELDS, default="inpainted", help="video: of which field")
    parser.add_argument("--map", choices=MAPS, default="colour", help="video: what of it")
    parser.add_argument("--seconds", type=float, default=8.0, help="video: how long")
    parser.add_argument("--rate", type=float, default=24.0, help="video: pictures a second")
    parser.add_argument("--width", type=int, default=480, help="video: pixels")
    parser.add_argument("--die-with-parent", action="store_true", help="end when whoever started this ends")
    return parser.parse_args(arguments)


def _carry_out(options: argparse.Namespace) -> None:
    torch.set_num_threads(options.threads)
    scene = open_scene(open_store(options.store), options)
    if options.command == "video":
        count = max(2, round(options.seconds * options.rate))
        cameras = interpolate([view.camera for view in scene.views.values()], count, options.width)
        write_film(options.out, scene, options.field, options.map, cameras, rate=options.rate, tick=_tell)
        return
    scene.warm_up()
    with PageServer(ViewerPages(scene).get, port=options.port) as server:
        server.announce_and_serve()


def open_scene(store: Store, options: argparse.Namespace) -> ViewerScene:
    """The fields that are named, with the capture's cameras."""
    capture = store.open(options.posed_capture, PosedCapture)
    masks = store.open(options.mask_set, MaskSet) if options.mask_set else None
    artifacts = {
        name: store.open(digest, RadianceFieldArtifact) for name in FIELDS if (digest := getattr(options, name))
    }
    return ViewerScene(
        title=options.title,
        fields={name: load_field(a.path(a.metadata.weights), a.metadata.spec).eval() for name, a in artifacts.items()},
        views={view.name: view for view in load_posed(capture)},
        masks=read_masks(masks, masks.metadata.views) if masks else {},
    )


def _tell(index: int, count: int) -> None:
    if index % 24 == 0:
        sys.stderr.write(f"picture {index} of {count}\n")
