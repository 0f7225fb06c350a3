"""What comes from outside is taken into the store as artifacts, so that everything downstream has a digest."""

import difflib
import shutil
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.artifacts import Capture, DiffusersPipeline, MaskRequestArtifact, Segmenter, Source
from inpaint3d.contracts.models.artifacts.masks import MaskRequest, list_views
from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.manifest import Manifest, describe_file, schema_id
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import Store, load_manifest
from inpaint3d.orchestrator.diffusers_pipeline import find_pipeline_folder, list_pipeline_files, read_kind
from inpaint3d.orchestrator.painting import take_painted
from inpaint3d.orchestrator.segmenter import recognise
from inpaint3d.orchestrator.source_files import list_source_files

MASK_REQUEST, PRIOR, CORPUS, DIFFUSERS = "mask-request", "pretrained-prior", "image-corpus", "diffusers-pipeline"
PAINTED, SEGMENTER = "painted-views", "segmenter"
MANY_VIEWS = 5
Given = Path | tuple[Path, Path]
"""What a command line gives for an external: a file or a folder, of a segmenter two files."""


def take_capture(store: Store, path: Path) -> Digest:
    """A folder of pictures or a data set, or a video file, byte for byte."""
    if not path.exists():
        raise BadInputError(f"{path} does not exist; give a folder of photos, a data set, or a video file")
    metadata = Source(name=path.resolve().name, kind="folder" if path.is_dir() else "file")
    if not path.is_dir():
        return _take_files(store, "source", metadata, _place_below("raw", path.parent, [path]))
    return _take_files(store, "source", metadata, _place_below("raw", path, list_source_files(path)))


def take_pipeline(store: Store, folder: Path) -> Digest:
    """A diffusers pipeline: what of its folder is needed to ask it."""
    metadata = DiffusersPipeline(kind=read_kind(folder))
    files = _place_below("pipeline", folder, list_pipeline_files(folder))
    return _take_files(store, "diffusers-pipeline", metadata, files)


def take_segmenter(store: Store, encoder: Path, decoder: Path) -> Digest:
    """A network that segments, as two ONNX files; ConfigurationError for files that are none that can be asked."""
    family, *weights = recognise(encoder, decoder)
    metadata = Segmenter(family=family)
    files: dict[str, Path] = {metadata.decoder: decoder, metadata.encoder: encoder}
    for network, beside in zip((metadata.encoder, metadata.decoder), weights, strict=True):
        files |= {str(PurePosixPath(network).parent / path.name): path for path in beside}
    return _take_files(store, "segmenter", metadata, dict(sorted(files.items())))


def _place_below(folder: str, root: Path, paths: list[Path]) -> dict[str, Path]:
    return {f"{folder}/{path.relative_to(root).as_posix()}": path for path in paths}


def _take_files(store: Store, name: str, metadata: Closed, files: Mapping[str, Path]) -> Digest:
    """Path in the artifact -> file, byte for byte, in the order of the paths. Nothing is copied that the store has."""
    described = tuple(describe_file(p.parent, p).model_copy(update={"path": place}) for place, p in files.items())
    manifest = Manifest(schema=schema_id(name), files=described, metadata=metadata.model_dump(mode="json"))
    if store.is_whole(manifest.digest):
        return manifest.digest
    folder = store.private_folder()
    for place, path in files.items():
        target = folder / place
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    return store.put(folder, name, metadata)


def take_mask_request(store: Store, path: Path) -> Digest:
    """A mask request, read from YAML and checked; ConfigurationError names the file and line."""
    request, _ = load_document(path, MaskRequest)
    return _take_files(store, "mask-request", MaskRequestArtifact(request=request), {})


def take_artifact(store: Store, path: Path, schema: str) -> Digest:
    """An artifact's folder as another store holds it (a pretrained prior, a corpus), verified on the way in."""
    manifest = load_manifest(path, schema)
    if store.is_whole(manifest.digest):
        return manifest.digest
    store.adopt(path, manifest)
    return manifest.digest


def locate_externals(
    *,
    mask: Path | None,
    prior: Path | None,
    corpus: Path | None,
    painted: Path | None = None,
    segmenter: tuple[Path, Path] | None = None,
) -> dict[str, Given]:
    """External -> what a command line gives for it.

    prior: a diffusion-prior artifact, or a diffusers pipeline (`diffusers_pipeline.find_pipeline_folder`).
    """
    paths: dict[str, Given | None] = {
        MASK_REQUEST: mask, PRIOR: prior, CORPUS: corpus, PAINTED: painted, SEGMENTER: segmenter,
    }  # fmt: skip
    if prior is not None and (folder := find_pipeline_folder(prior)) is not None:
        paths |= {PRIOR: None, DIFFUSERS: folder}
    return {external: path for external, path in paths.items() if path is not None}


def list_externals(pipeline: Pipeline, paths: Mapping[str, Given]) -> set[str]:
    """The externals that a run has: the capture, what is given, and the pipeline's defaults."""
    declared = pipeline.spec.spec.externals
    return {"capture", *paths, *(name for name, external in declared.items() if external.default is not None)}


def take_externals(store: Store, pipeline: Pipeline, capture: Path, paths: Mapping[str, Given]) -> dict[str, Digest]:
    """What a scene's nodes read from outside, by `locate_externals`; for what is not given, the pipeline's default."""
    externals: dict[str, Digest] = {}
    read = {ref for node in pipeline.order for refs in pipeline.references(node).values() for ref in refs}
    for name, declared in pipeline.spec.spec.externals.items():
        default = pipeline.path.parent / declared.default if declared.default else None
        if f"external.{name}" in read and name != "capture" and (path := paths.get(name, default)) is not None:
            externals[name] = _take(store, name, path, declared.schema_range)
    return externals | {"capture": take_capture(store, capture)}  # last: it may take long


def _take(store: Store, external: str, path: Given, schema: str) -> Digest:
    if isinstance(path, tuple):
        return take_segmenter(store, *path)
    if external == MASK_REQUEST:
        return take_mask_request(store, path)
    if external == PAINTED:
        return take_painted(store, path)
    return take_pipeline(store, path) if external == DIFFUSERS else take_artifact(store, path, schema)


def find_unknown_view(store: Store, request: Digest, capture: Digest, file: Path | None) -> str | None:
    """What is wrong with the view that a mask request points at: it is none of the capture's; None where nothing is."""
    asked = list_views(MaskRequestArtifact.model_validate(store.manifest(request).metadata).request.mask)
    names = [frame.name for frame in Capture.model_validate(store.manifest(capture).metadata).frames]
    unknown = next((name for name in asked if name not in names), None)
    if unknown is None:
        return None
    near = difflib.get_close_matches(unknown, names, n=MANY_VIEWS) or names[:MANY_VIEWS]
    more = f" and {len(names) - len(near)} more" if len(names) > len(near) else ""
    return f"{file or 'the mask request'}: mask.view: no view {unknown}; there are {', '.join(near)}{more}"


def name_run(capture: Path, given: str | None) -> str:
    """The name given, else the capture's folder name. It is a folder's name, so that it cannot lead elsewhere."""
    whole = capture.resolve()
    name = given if given is not None else whole.name if whole.is_dir() else whole.stem
    if name in ("", ".", "..") or "/" in name:
        raise ConfigurationError(f"--name {name}: it names a folder below --runs-dir; give one without a slash")
    return name


def list_scenes(capture: Path, scenes: list[str] | None, name: str | None) -> list[tuple[Path, str | None]]:
    """The captures to run, with their names: the one given, or one for each `--scene` below it."""
    if not scenes:
        return [(capture, name)]
    for scene in scenes:
        if not (capture / scene).exists():
            raise ConfigurationError(f"--scene {scene}: there is no {capture / scene}")
    named = {scene: "-".join(Path(scene).parts) for scene in scenes}
    return [(capture / scene, f"{name}-{n}" if name else n) for scene, n in named.items()]
