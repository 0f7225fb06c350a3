"""The key of a stage run: everything that its result depends on, and nothing else.

Not in it: resources, retries, threads, absolute paths. Two tiers (key -> outputs -> objects) give early
cut-off: inputs are *content* digests, so that an upstream rerun that produces identical bytes reruns nothing.
"""

import functools
import importlib.metadata
import json
import os
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import digest_of, tree_digest
from inpaint3d.contracts.models.stage import StageSpec

ALGORITHM = "1"
IMAGE_DIGEST = "INPAINT3D_IMAGE_DIGEST"
PREFIX = "inpaint3d-"
# Everything that a stage computes with lives in these; the rest of a package's folder (tests, docs) does not count.
SOURCE_FOLDERS = ("src", "csrc")
SOURCE_SUFFIXES = (".py", ".cpp", ".hpp", ".h", ".txt", ".json", ".html", ".j2")

Inputs = dict[str, Digest | list[Digest]]


def key_components(
    spec: StageSpec,
    *,
    code: Digest,
    parameters: dict[str, Any],
    inputs: Inputs,
    seed: int,
    device: str,
    stub: bool = False,
) -> dict[str, Any]:
    """What the key is taken over, by name, so that a difference can be explained."""
    components: dict[str, Any] = {
        "algorithm": ALGORITHM,
        "stage": spec.id,
        "code": code,
        "parameters": parameters,
        "inputs": inputs,
        "outputs": {name: port.schema_id for name, port in spec.spec.outputs.items()},
        "seed": seed,
        "device": device,
    }
    return components | ({"stub": True} if stub else {})


def run_key(components: dict[str, Any]) -> Digest:
    return digest_of(components)


def code_digest(module: str) -> Digest:
    """The image's digest in a container; else one over the source here and the versions of what it depends on."""
    if image := os.environ.get(IMAGE_DIGEST):
        return image
    return local_code_digest(distribution_of(module))


def distribution_of(module: str) -> str:
    """`inpaint3d.stages.nerf_pretraining` -> `inpaint3d-nerf-pretraining`."""
    return PREFIX + module.rpartition(".")[2].replace("_", "-")


@functools.cache
def local_code_digest(distribution: str) -> Digest:
    """Digest of a distribution's own source and of all that it requires, as installed here."""
    closure = _closure(distribution)
    parts: dict[str, str] = {}
    for name in sorted(closure):
        parts[name] = _source_digest(name) if name.startswith(PREFIX) else _installed(name)[0]
    return digest_of(parts)


@functools.cache
def _closure(distribution: str) -> frozenset[str]:
    found: set[str] = set()
    waiting = [distribution]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        try:
            _, required = _installed(name)
        except importlib.metadata.PackageNotFoundError as error:
            if name == distribution:
                raise ConfigurationError(f"{name} is not installed; run `make install`") from error
            continue  # asked for on another platform only
        found.add(name)
        for line in required:
            if "extra ==" not in line and (match := re.match(r"[A-Za-z0-9._-]+", line)):
                waiting.append(re.sub(r"[-_.]+", "-", match.group()).lower())
    return frozenset(found)


@functools.cache
def _installed(distribution: str) -> tuple[str, tuple[str, ...]]:
    """Version and requirements, read once: stages share most of what they depend on, and parsing is slow."""
    metadata = importlib.metadata.metadata(distribution)
    return metadata["Version"], tuple(metadata.get_all("Requires-Dist") or ())


@functools.cache
def _source_digest(distribution: str) -> Digest:
    origin = importlib.metadata.distribution(distribution).read_text("direct_url.json")
    project = Path(unquote(urlparse(str(json.loads(origin)["url"])).path)) if origin else None
    if project is None or not (project / "src").is_dir():
        raise ConfigurationError(
            f"{distribution} is installed without its source, and {IMAGE_DIGEST} is not set; set it to the image's"
        )
    trees = [tree_digest(project / folder, SOURCE_SUFFIXES) for folder in SOURCE_FOLDERS if (project / folder).is_dir()]
    return digest_of(trees)
