"""Numbers that are not finite, put into what each stage reads, and what it says of them.

    python -m tests.stability.stage_faults

Inputs are made by the stubs. Stages run in processes forked from this one, which has imported torch once for all.
"""

import json
import runpy
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch  # noqa: F401 - for what is forked
import yaml
from safetensors.numpy import load_file, save_file

from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.kit.upstream import Upstream, build_command
from inpaint3d.contracts.models.artifacts import SCHEMAS
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.manifest import MANIFEST, split_schema
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore
from inpaint3d.scene.map_io import read_exr
from tests.conftest import REPOSITORY
from tests.faults.forks import fork, wait_for
from tests.stability.test_files import write_float


class StageFault(NamedTuple):
    """A number of an array in a file of an input.

    said: what the stage's error matches. parameters: over those of a tiny run.
    """

    node: str
    port: str
    file: str
    array: str
    value: float
    said: str
    parameters: dict[str, Any] = {}

    @property
    def what(self) -> str:
        file = self.file.replace("*.exr", "its EXR files")
        return f"{self.value} in {self.array} of {file}, at {self.node}'s input {self.port}"


COMPLETED = {"estimator": {"name": "completed-views"}}


def _points(node: str) -> StageFault:
    said = r"points\.safetensors: numbers that are not finite: xyz \(1, the first at \[1, 0\]\); run pose-estimation"
    return StageFault(node, "posed-capture", "points.safetensors", "xyz", np.nan, said)


def _weights(node: str, port: str) -> StageFault:
    said = r"weights .*weights\.safetensors are not finite: base\.table \(1, the first at \[1, "
    return StageFault(node, port, "weights.safetensors", "base.table", np.inf, said)


def _map(node: str, port: str, array: str) -> StageFault:
    said = rf"\.exr holds numbers that are not finite: {array} \(1, the first at \[0, 3\]\)"
    return StageFault(node, port, "*.exr", array, np.nan, said)


FAULTS = [
    *map(_points, ("scene-analysis", "nerf-pretraining", "masked-reconstruction", "view-completion")),
    _map("mask-authoring", "radiance-field", "median.Z"),
    _weights("joint-optimization", "initial-field"),
    StageFault(
        "joint-optimization", "diffusion-prior", "weights.safetensors", "network.stem.weight", np.nan,
        r"diffusion-prior: weights\.safetensors cannot be read .*not finite: network\.stem\.weight \(1, the first at",
    ),
    _map("joint-optimization", "completed-views", "depth.Z")._replace(parameters=COMPLETED),
    _weights("evaluation", "radiance-fields"),
    _map("usd-export", "inpainted", "median.Z"),
    _map("plate-export", "completed-views", "depth.Z"),
]  # fmt: skip


def try_all(folder: Path) -> Iterator[tuple[StageFault, int, str]]:
    """Each fault, the code that the stage ended with, and its message."""
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml").under(None)
    upstream = Upstream(pipeline, "plate-export", FolderStore(folder / "store"))
    for node in ("evaluation", "usd-export"):
        upstream.prepare(node)
    for fault in FAULTS:
        yield fault, *run_stage(upstream, fault, folder)


def run_stage(upstream: Upstream, fault: StageFault, folder: Path) -> tuple[int, str]:
    """Exit code and message of a stage that reads a damaged input."""

    def become() -> None:
        # All of it in the fork: libraries that have started threads cannot be used on its other side.
        spec = upstream.pipeline.stages[fault.node]
        line = build_command(spec, upstream.store, ask(upstream, fault))
        sys.argv = ["run", *line[line.index("run") :]]
        runpy.run_module(spec.spec.module, run_name="__main__", alter_sys=True)

    out = folder / "stdout.txt"
    code = wait_for(fork(become, folder / "stderr.txt", out))
    events: list[dict[str, Any]] = [json.loads(text) for text in out.read_text().splitlines()]
    return code, str(events[-1].get("message", "")) if events else (folder / "stderr.txt").read_text()


def ask(upstream: Upstream, fault: StageFault) -> Invocation:
    """A tiny run of the node, on its inputs, one of which is damaged."""
    inputs = upstream.inputs_of(fault.node)
    given = inputs[fault.port]
    damaged = damage(upstream.store, given[0] if isinstance(given, list) else given, fault)
    inputs[fault.port] = [damaged, *given[1:]] if isinstance(given, list) else damaged
    node = upstream.pipeline.nodes[fault.node]
    tiny: dict[str, Any] = yaml.safe_load((REPOSITORY / node.stage / "tests" / "tiny.yaml").read_text()) or {}
    return Invocation(
        inputs=inputs, parameters=tiny | node.parameters | fault.parameters, threads=1, accept_doubtful=True
    )


def damage(store: FolderStore, digest: Digest, fault: StageFault) -> Digest:
    """The artifact with one number replaced, and right digests: as a stage with a bug would have written it."""
    manifest = store.manifest(digest)
    name = split_schema(manifest.schema_id)[0]
    metadata = store.open(digest, SCHEMAS[name][1]).metadata
    folder = store.private_folder()
    for entry in manifest.files:
        (folder / entry.path).parent.mkdir(parents=True, exist_ok=True)
        (folder / entry.path).write_bytes((store.fetch(digest) / entry.path).read_bytes())
    (folder / MANIFEST).unlink(missing_ok=True)
    for path in sorted(folder.rglob(fault.file)):
        replace_number(path, fault.array, fault.value)
    return store.put(folder, name, metadata)


def replace_number(path: Path, array: str, value: float) -> None:
    """Make the fourth number of an array in a file another."""
    if path.suffix == ".exr":
        channels = read_exr(path)
        channels[array].reshape(-1)[3] = value
        write_float(path, np.stack(list(channels.values()), -1), list(channels))
        return
    arrays = load_file(path)
    arrays[array].reshape(-1)[3] = value
    save_file(arrays, path)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        told = [(fault.what, code, message) for fault, code, message in try_all(Path(folder))]
    sys.stdout.write(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
