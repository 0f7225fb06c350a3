"""An image corpus out of a folder: python -m inpaint3d.stages.diffusion_training.corpus FOLDER OUT

FOLDER is RealEstate10k (camera files beside folders of frames), or any folder of pictures: a folder in it is a scene, a
picture at its top one of its own. OUT becomes an image-corpus artifact, for `inpaint3d run --corpus OUT`. Which scenes
are held out, a hash of their names decides (of a video's address in RealEstate10k, whose clips share scenes), unless
RealEstate10k's own folders `train` and `test` say so: never two frames of one scene on both sides (D1).
"""

import argparse
import hashlib
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.commands import exit_on_error
from inpaint3d.contracts.models.artifacts import ImageCorpus
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES
from inpaint3d.contracts.models.canonical import canonical_json
from inpaint3d.contracts.models.manifest import MANIFEST, build_manifest
from inpaint3d.scene.image_io import read_image
from inpaint3d.scene.realestate10k import camera_files, read_clips

Split = Literal["train", "test"]


@dataclass(frozen=True)
class Found:
    """A picture of a folder that is to become part of a corpus."""

    name: str
    path: Path
    scene: str
    split: Split


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--held-out", type=float, default=0.1, help="share of scenes for judging alone")
    parser.add_argument("--every", type=int, default=1, help="of a clip's frames take one in so many")
    options = parser.parse_args()
    with exit_on_error("corpus"):
        pictures = write_corpus(options.folder, options.out, held_out=options.held_out, every=options.every)
    held_out = sum(picture.split == "test" for picture in pictures)
    scenes = len({picture.scene for picture in pictures})
    sys.stdout.write(f"{options.out}: {len(pictures)} pictures of {scenes} scenes, {held_out} pictures held out\n")


def write_corpus(folder: Path, out: Path, *, held_out: float = 0.1, every: int = 1) -> tuple[ImageCorpus.Picture, ...]:
    """Copy the pictures of `folder` into an image-corpus artifact at `out`, which must not be there yet.

    held_out: share of scenes in the test split. Every picture is decoded once. Raises BadInputError for a folder
    without pictures, a picture that is damaged, or an `out` that is there.
    """
    if out.exists():
        raise BadInputError(f"{out} is there already; remove it or name another folder")
    found = list(
        _find_frames(folder, held_out, every) if next(camera_files(folder), None) else _find_pictures(folder, held_out)
    )
    if not found:
        raise BadInputError(f"no pictures in {folder}; give a folder of pictures, or RealEstate10k with its frames")
    partial = out.with_name(f"{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    pictures = tuple(_copy_picture(picture, partial) for picture in found)
    manifest = build_manifest(partial, "image-corpus", ImageCorpus(pictures=pictures))
    (partial / MANIFEST).write_bytes(canonical_json(manifest.dump()))
    partial.rename(out)
    return pictures


def _find_frames(folder: Path, held_out: float, every: int) -> Iterator[Found]:
    for clip in read_clips(folder):
        split = clip.split or _split(clip.video, held_out)
        for frame in clip.frames[::every]:
            yield Found(f"{clip.name}_{frame.image.stem}", frame.image, clip.video, split)


def _find_pictures(folder: Path, held_out: float) -> Iterator[Found]:
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and p.suffix.lower() in PICTURE_SUFFIXES):
        parts = path.relative_to(folder).parts
        scene = parts[0]
        yield Found("_".join([*parts[:-1], path.name.replace(".", "_")]), path, scene, _split(scene, held_out))


def _split(scene: str, held_out: float) -> Split:
    """By the scene's name alone: another picture or another folder changes nothing of it."""
    share = int.from_bytes(hashlib.sha256(scene.encode()).digest()[:8]) / 2**64
    return "test" if share < held_out else "train"


def _copy_picture(picture: Found, root: Path) -> ImageCorpus.Picture:
    read_image(picture.path)  # a damaged one is found here, not after a night of training
    path = f"images/{picture.name}{picture.path.suffix.lower()}"
    if (root / path).exists():
        raise BadInputError(f"{picture.path} and another picture would both be called {picture.name}; rename one")
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(picture.path, root / path)
    return ImageCorpus.Picture(name=picture.name, path=path, scene=picture.scene, split=picture.split)


if __name__ == "__main__":
    main()
