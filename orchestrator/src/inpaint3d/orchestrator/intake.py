"""What comes from outside is taken into the store as artifacts, so that everything downstream has a digest."""

import shutil
from pathlib import Path

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.artifacts import DiffusersPipeline, MaskRequestArtifact, Source
from inpaint3d.contracts.models.artifacts.masks import MaskRequest
from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.manifest import Manifest, describe_file, schema_id
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import Store, load_manifest
from inpaint3d.orchestrator.foreign import kind_of, pipeline_files, pipeline_folder


def take_capture(store: Store, path: Path) -> Digest:
    """A folder of pictures or a data set, or a video file, byte for byte."""
    if not path.exists():
        raise BadInputError(f"{path} does not exist; give a folder of photos, a data set, or a video file")
    metadata = Source(name=path.resolve().name, kind="folder" if path.is_dir() else "file")
    if not path.is_dir():
        return _take_files(store, "source", metadata, path.parent, [path], "raw")
    visible = [
        p
        for p in sorted(path.rglob("*"))
        if p.is_file() and not any(part.startswith(".") for part in p.relative_to(path).parts)
    ]
    return _take_files(store, "source", metadata, path, visible, "raw")


def take_pipeline(store: Store, folder: Path) -> Digest:
    """A diffusers pipeline: what of its folder is needed to ask it."""
    metadata = DiffusersPipeline(kind=kind_of(folder))
    return _take_files(store, "diffusers-pipeline", metadata, folder, pipeline_files(folder), "pipeline")


def _take_files(store: Store, name: str, metadata: Closed, root: Path, paths: list[Path], below: str) -> Digest:
    """Files of `root`, byte for byte, `below` a folder of the artifact. Nothing is copied that the store has."""
    entries = [describe_file(root, p) for p in paths]
    files = tuple(e.model_copy(update={"path": f"{below}/{e.path}"}) for e in entries)
    manifest = Manifest(schema=schema_id(name), files=files, metadata=metadata.model_dump(mode="json"))
    if store.is_whole(manifest.digest):
        return manifest.digest
    folder = store.private_folder()
    for entry in entries:
        target = folder / below / entry.path
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / entry.path, target)
    return store.put(folder, name, metadata)


def take_mask_request(store: Store, path: Path) -> Digest:
    """A mask request, read from YAML and checked; ConfigurationError names the file and line."""
    request, _ = load_document(path, MaskRequest)
    return store.put(store.private_folder(), "mask-request", MaskRequestArtifact(request=request))


def take_artifact(store: Store, path: Path, schema: str) -> Digest:
    """An artifact's folder as another store holds it (a pretrained prior, a corpus), verified on the way in."""
    manifest = load_manifest(path, schema)
    if store.is_whole(manifest.digest):
        return manifest.digest
    store.adopt(path, manifest)
    return manifest.digest


def take_externals(
    store: Store, pipeline: Pipeline, capture: Path, *, mask: Path | None, prior: Path | None, corpus: Path | None
) -> dict[str, Digest]:
    """Everything that a scene brings from outside; for what is not given, the pipeline's default if it has one.

    prior: a diffusion-prior artifact, or a diffusers pipeline (`foreign.pipeline_folder`), which is asked beside it.
    """
    externals: dict[str, Digest] = {"capture": take_capture(store, capture)}
    if mask is not None:
        externals["mask-request"] = take_mask_request(store, mask)
    if prior is not None and (foreign := pipeline_folder(prior)) is not None:
        if "diffusers-pipeline" not in pipeline.spec.spec.externals:
            raise ConfigurationError(f"{pipeline.path} has no external diffusers-pipeline, which {prior} would be")
        externals["diffusers-pipeline"], prior = take_pipeline(store, foreign), None
    for external, given in (("pretrained-prior", prior), ("image-corpus", corpus)):
        declared = pipeline.spec.spec.externals.get(external)
        if declared is None:
            continue
        default = pipeline.path.parent / declared.default if declared.default else None
        if (folder := given or default) is not None:
            externals[external] = take_artifact(store, folder, declared.schema_range)
    return externals


def run_name(capture: Path, given: str | None) -> str:
    """The name given, else the capture's folder name. It is a folder's name, so that it cannot lead elsewhere."""
    whole = capture.resolve()
    name = given if given is not None else whole.name if whole.is_dir() else whole.stem
    if name in ("", ".", "..") or "/" in name:
        raise ConfigurationError(f"--name {name}: it names a folder below --runs-dir; give one without a slash")
    return name


def scenes_of(capture: Path, scenes: list[str] | None, name: str | None) -> list[tuple[Path, str | None]]:
    """The captures to run, with their names: the one given, or one for each `--scene` below it."""
    if not scenes:
        return [(capture, name)]
    for scene in scenes:
        if not (capture / scene).exists():
            raise ConfigurationError(f"--scene {scene}: there is no {capture / scene}")
    named = {scene: "-".join(Path(scene).parts) for scene in scenes}
    return [(capture / scene, f"{name}-{n}" if name else n) for scene, n in named.items()]
