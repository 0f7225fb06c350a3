"""A run that a store remembers, and what its stages made."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import SCHEMAS
from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.manifest import Manifest, split_schema
from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.store import Store, open_store
from inpaint3d.orchestrator.history import History, name_status
from inpaint3d.orchestrator.options import STORE
from inpaint3d.orchestrator.pages.pictures import choose_evenly, embed
from inpaint3d.report.page import render

PICTURES = 6


@dataclass(frozen=True)
class StoredArtifact:
    """An artifact of a run: `metadata` is the model of its schema, `path` finds its files."""

    store: Store
    name: str
    digest: Digest

    @cached_property
    def manifest(self) -> Manifest:
        return self.store.manifest(self.digest)

    @cached_property
    def metadata(self) -> Closed:
        """ArtifactError where it is not what its schema says."""
        _, model = SCHEMAS[split_schema(self.manifest.schema_id)[0]]
        return self.store.open(self.digest, model).metadata

    @property
    def files(self) -> list[str]:
        return [file.path for file in self.manifest.files]

    def path(self, file: str) -> Path:
        """Where a file of it lies, to be read only; ConfigurationError for one that it has not."""
        if file not in self.files:
            raise ConfigurationError(f"{self.name} has no file {file}; it has {', '.join(self.files[:5]) or 'none'}")
        return self.store.fetch(self.digest) / file

    def __repr__(self) -> str:
        return f"<{self.name}: {self.manifest.schema_id}, {len(self.files)} files, {self.digest[7:19]}>"

    def _repr_html_(self) -> str:
        names = choose_evenly([file for file in self.files if file.endswith(".png")], PICTURES)
        pictures = {name: embed(self.path(name).read_bytes()) for name in names}
        fields = {name: _shorten(value) for name, value in self.metadata}
        return render("inpaint3d.client", "artifact.html.j2", artifact=self, fields=fields, pictures=pictures)


@dataclass(frozen=True)
class Run:
    """A run by its record; `run["NODE"]` or `run["NODE.OUTPUT"]` is an artifact of it."""

    store: Store
    record: RunRecord

    @property
    def name(self) -> str:
        return self.record.name

    @property
    def status(self) -> str:
        return name_status(self.record)

    @cached_property
    def artifacts(self) -> dict[str, StoredArtifact]:
        """`NODE.OUTPUT` -> artifact, in the order of the pipeline."""
        return {name: StoredArtifact(self.store, name, digest) for name, digest in self._list()}

    def __getitem__(self, name: str) -> StoredArtifact:
        """The artifact of a node and output, or of a node that has one; ConfigurationError for any other name."""
        found = [a for full, a in self.artifacts.items() if name in (full, full.partition(".")[0])]
        if len(found) != 1:
            what = "has no" if not found else "has several"
            raise ConfigurationError(f"{self.name} {what} {name}; there are {', '.join(self.artifacts) or 'none yet'}")
        return found[0]

    def __repr__(self) -> str:
        return f"<run {self.name}: {self.status}, {len(self.artifacts)} artifacts>"

    def _repr_html_(self) -> str:
        return render("inpaint3d.client", "run.html.j2", run=self)

    def _list(self) -> Iterator[tuple[str, Digest]]:
        for node in self.record.nodes:
            yield from ((f"{node.node}.{port}", digest) for port, digest in node.outputs.items())


def open_run(name: str, store: str | None = None) -> Run:
    """The last run of a name; `store`: a folder or s3://BUCKET/PREFIX, else INPAINT3D_STORE, else the command line's.

    ConfigurationError where there is no such run.
    """
    opened = open_store(store or os.environ.get("INPAINT3D_STORE", STORE))
    return Run(opened, History(opened).latest(name))


def _shorten(value: Any) -> str:
    if isinstance(value, tuple) and len(many := cast(tuple[Any, ...], value)) > 3:
        return f"{len(many)} of them"
    text = str(cast(object, value))
    return text if len(text) <= 200 else f"{text[:200]} …"
