"""The code that a stage runs: its digest, which stands for it in keys, and the files and versions behind that digest.

A store keeps what lies behind each digest that a result was computed with (`code/DIGEST.json`), so that a later run can
name the files that changed. What counts as a change: docs/adr/0009.
"""

import functools
import importlib.machinery
import importlib.metadata
import json
import os
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.bytecode import digest_python
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import canonical_json, digest_of, file_digest
from inpaint3d.contracts.models.report import Change
from inpaint3d.contracts.store import Store, hex_of

IMAGE_DIGEST = "INPAINT3D_IMAGE_DIGEST"
PREFIX = "inpaint3d-"
CODE_FOLDER = "code"
# Everything that a stage computes with lives in these; the rest of a package's folder (tests, docs) does not count.
SOURCE_FOLDERS = ("src", "csrc")
SOURCE_SUFFIXES = (".py", ".cpp", ".hpp", ".h", ".txt", ".json", ".html", ".j2")
# Of what is compiled a wheel has the result in place of the source.
INSTALLED_SUFFIXES = (*SOURCE_SUFFIXES, *importlib.machinery.EXTENSION_SUFFIXES)

Listing = dict[str, str]
"""`python` and PACKAGE -> version; of our own packages PACKAGE/PATH -> digest."""

_listed: dict[Digest, Listing] = {}
"""What this process has listed: a plan names changes before any stage has left its listing in the store."""


def code_digest(module: str) -> Digest:
    """The image's digest in a container; else one over the source here and the versions of what it depends on."""
    return os.environ.get(IMAGE_DIGEST) or _digest_listing(list_code(distribution_of(module)))


def save_code(store: Store, module: str) -> None:
    """Leave what lies behind the code's digest in a store. An image's digest has nothing behind it."""
    if IMAGE_DIGEST not in os.environ:
        save_listing(store, list_code(distribution_of(module)))


def save_listing(store: Store, listing: Listing) -> Digest:
    """Leave a listing in a store, where it is not there yet; its digest."""
    digest = _digest_listing(listing)
    store.create(code_path(digest), canonical_json(listing))
    return digest


def code_path(digest: Digest) -> str:
    """Where a store keeps what lies behind a code's digest."""
    return f"{CODE_FOLDER}/{hex_of(digest)}.json"


def name_changed_files(changes: tuple[Change, ...], store: Store) -> tuple[Change, ...]:
    """The same changes; one of `code` becomes one for each file and package version that differs, where both known."""
    found: list[Change] = []
    for change in changes:
        found += _list_code_changes(store, change) if change.component == "code" else [change]
    return tuple(found)


def _list_code_changes(store: Store, change: Change) -> list[Change]:
    old, new = _find_listing(store, change.old), _find_listing(store, change.new)
    if old is None or new is None:
        return [change]
    # Another minor version compiles every file anew: that none of them is the same says nothing.
    compared = [n for n in sorted({*old, *new}) if old["python"] == new["python"] or not n.endswith(".py")]
    return [
        Change(component=f"code.{name}", old=old.get(name), new=new.get(name))
        for name in compared
        if old.get(name) != new.get(name)
    ]


def _find_listing(store: Store, digest: Digest | None) -> Listing | None:
    if digest is None or digest in _listed:
        return _listed.get(digest or "")
    data = store.read(code_path(digest))
    return json.loads(data) if data else None


def _digest_listing(listing: Listing) -> Digest:
    digest = digest_of(listing)
    _listed[digest] = listing
    return digest


def distribution_of(module: str) -> str:
    """`inpaint3d.stages.nerf_pretraining` -> `inpaint3d-nerf-pretraining`."""
    return PREFIX + module.rpartition(".")[2].replace("_", "-")


@functools.cache
def list_code(distribution: str) -> Listing:
    """A distribution's own source, that of ours which it requires, and the versions of everybody else's."""
    listing: Listing = {"python": f"{sys.version_info.major}.{sys.version_info.minor}"}
    for name in find_requirements(distribution):
        if name.startswith(PREFIX):
            listing |= {f"{name}/{path}": digest for path, digest in _digest_package(name).items()}
        else:
            listing[name] = _read_metadata(name)[0]
    return listing


def _digest_package(distribution: str) -> dict[str, Digest]:
    project = _find_project(distribution)
    return digest_installed(distribution) if project is None else digest_sources(project)


@functools.cache
def digest_sources(project: Path) -> dict[str, Digest]:
    """Path -> digest of the source files of a package's folder: of Python what it runs, of all others the bytes."""
    return _digest_files({inside: project / inside for inside in _find_sources(project)})


@functools.cache
def digest_installed(distribution: str) -> dict[str, Digest]:
    """The same of a package that was installed from a wheel: where nothing is compiled, equal to that of its source."""
    namespace, source = PREFIX.rstrip("-"), SOURCE_FOLDERS[0]
    files = [
        file
        for file in importlib.metadata.distribution(distribution).files or ()
        if file.parts[0] == namespace and file.name.endswith(INSTALLED_SUFFIXES)
    ]
    if not files:
        raise ConfigurationError(f"{distribution} is installed without a list of its files; install it again")
    return _digest_files({f"{source}/{file.as_posix()}": Path(str(file.locate())) for file in files})


def _digest_files(paths: Mapping[str, Path]) -> dict[str, Digest]:
    return {
        name: digest_python(path) if path.suffix == ".py" else file_digest(path) for name, path in sorted(paths.items())
    }


def _find_sources(project: Path) -> Iterator[str]:
    """Paths below the project, with slashes. By `os.walk`: each stage's process does this."""
    for source in SOURCE_FOLDERS:
        for folder, inner, files in os.walk(project / source):
            inner[:] = [name for name in inner if not name.startswith(".") and name != "__pycache__"]
            inside = folder[len(str(project)) + 1 :]
            yield from (f"{inside}/{n}" for n in files if n.endswith(SOURCE_SUFFIXES) and not n.startswith("."))


def _find_project(distribution: str) -> Path | None:
    """The checkout's folder of one of our own packages that is edited in place; None: installed from a wheel."""
    written = importlib.metadata.distribution(distribution).read_text("direct_url.json")
    origin: dict[str, Any] = json.loads(written) if written else {}
    if not origin.get("dir_info", {}).get("editable"):
        return None
    return Path(unquote(str(urlparse(str(origin["url"])).path)))


@functools.cache
def find_requirements(distribution: str) -> frozenset[str]:
    """A distribution and all that it requires, directly or not, as far as it is installed here."""
    found: set[str] = set()
    waiting = [distribution]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        try:
            _, required = _read_metadata(name)
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
def _read_metadata(distribution: str) -> tuple[str, tuple[str, ...]]:
    """Version and requirements, read once: stages share most of what they depend on.

    Line by line, up to the description: the e-mail parser of `importlib.metadata` takes ten times as long.
    """
    text = importlib.metadata.distribution(distribution).read_text("METADATA") or ""
    version, required = "", list[str]()
    for line in text.partition("\n\n")[0].splitlines():
        name, _, value = line.partition(": ")
        if name == "Version":
            version = value.strip()
        elif name == "Requires-Dist":
            required.append(value.strip())
    return version, tuple(required)
