"""What a pipeline costs beyond its stages: CPU seconds of eleven stages that do nothing, first run and second.

python -m benchmarks.overhead [--dvc FILE] [--snakemake FILE] [--repeats 3] [--out FILE.json]

The same graph in each system (one source, nine stages that read it, one that reads the nine), in one run, in turns.
Ours verifies inputs against their digests, validates, hashes and commits what a Python process wrote; the stages of the
peers are `cat`, by a shell. CPU seconds are those of all processes; the fewest of the repeats counts.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from benchmarks.provenance import commit

from inpaint3d.contracts.schemas import build_schema

WIDTH = 9
NOOP = {
    "__init__.py": "",
    "__main__.py": "from inpaint3d.contracts.kit.shim import serve\n\nserve('inpaint3d.stages.noop')\n",
    "config.py": "from inpaint3d.contracts.models.base import Closed\n\n\nclass Config(Closed):\n    number: int = 0\n",
    "run.py": (
        "from inpaint3d.contracts.models.artifacts import Source\n\n\n"
        "def run(config, inputs, outputs, ctx):\n"
        "    (outputs.folder('made') / 'number.txt').write_text(str(config.number))\n"
        "    outputs.write('made', Source(name=str(config.number), kind='folder'))\n"
    ),
}
STAGE = {
    "apiVersion": "inpaint3d/v1", "kind": "Stage", "metadata": {"name": "noop", "version": "0.1.0"},
    "spec": {
        "module": "inpaint3d.stages.noop", "image": "inpaint3d/noop", "description": "Does nothing.",
        "inputs": {"source": {"schema": "source@1", "list": True}}, "outputs": {"made": {"schema": "source@1.0"}},
        "resources": {"requests": {"cpu": "1", "memory": "256Mi"}, "limits": {"memory": "256Mi"}},
        "activeDeadlineSeconds": 600,
    },
}  # fmt: skip


@dataclass(frozen=True)
class System:
    """A pipeline in a folder, and the command that runs it."""

    name: str
    folder: Path
    command: list[str]
    environment: dict[str, str]

    def measure(self) -> dict[str, float]:
        """CPU and wall seconds of one run of all its processes."""
        before, start = _children_cpu_s(), time.perf_counter()
        subprocess.run(self.command, cwd=self.folder, env=self.environment, check=True, capture_output=True)
        return {"cpu_s": _children_cpu_s() - before, "wall_s": time.perf_counter() - start}


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def write_ours(folder: Path, width: int = WIDTH) -> System:
    """Our pipeline of the no-op stage, an installed package as far as the interpreter can tell."""
    package = folder / "stage" / "src" / "inpaint3d" / "stages" / "noop"
    package.mkdir(parents=True)
    for name, text in NOOP.items():
        (package / name).write_text(text)
    (folder / "stage" / "stage.yaml").write_text(yaml.safe_dump(STAGE))
    installed = folder / "stage" / "src" / "inpaint3d_noop-0.1.0.dist-info"
    installed.mkdir()
    metadata = "Metadata-Version: 2.1\nName: inpaint3d-noop\nVersion: 0.1.0\nRequires-Dist: inpaint3d-contracts\n\n"
    (installed / "METADATA").write_text(metadata)
    (installed / "direct_url.json").write_text(
        json.dumps({"url": (folder / "stage").as_uri(), "dir_info": {"editable": True}})
    )
    schemas = folder / "schemas" / "parameters"
    schemas.mkdir(parents=True)
    (schemas / "noop.json").write_text(json.dumps(_noop_schema()))
    spread = [_node(f"spread-{i}", i, ["first.made"]) for i in range(width)]
    last = _node("last", width + 1, [f"{n['name']}.made" for n in spread])
    document = {
        "apiVersion": "inpaint3d/v1", "kind": "Pipeline", "metadata": {"name": "noop"},
        "spec": {
            "externals": {"capture": {"schema": "source@1"}},
            "stages": [_node("first", width, ["external.capture"]), *spread, last],
        },
    }  # fmt: skip
    (folder / "pipeline.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    (folder / "capture").mkdir()
    (folder / "capture" / "note.txt").write_text("nothing")
    command = [str(Path(sys.executable).parent / "inpaint3d"), "run", "capture", "--store", "store"]
    return System("inpaint3d", folder, command, {**_environment(), "PYTHONPATH": str(folder / "stage" / "src")})


def _node(name: str, number: int, references: list[str]) -> dict[str, Any]:
    return {"name": name, "stage": "stage", "inputs": {"source": references}, "parameters": {"number": number}}


def _noop_schema() -> dict[str, Any]:
    scope: dict[str, Any] = {}
    exec(NOOP["config.py"], scope)
    return build_schema(scope["Config"], "parameters/noop", "1")


def write_dvc(folder: Path, program: Path, width: int = WIDTH) -> System:
    names = [f"spread-{i}" for i in range(width)]
    stages = {"first": {"cmd": "cat source > first", "deps": ["source"], "outs": ["first"]}}
    stages |= {n: {"cmd": f"cat first > {n}", "deps": ["first"], "outs": [n]} for n in names}
    stages["last"] = {"cmd": f"cat {' '.join(names)} > last", "deps": names, "outs": ["last"]}
    (folder / "dvc.yaml").write_text(yaml.safe_dump({"stages": stages}, sort_keys=False))
    (folder / "source").write_text("nothing")
    environment = {**_environment(), "DVC_NO_ANALYTICS": "1"}
    subprocess.run([program, "init", "--no-scm", "-q"], cwd=folder, env=environment, check=True)
    return System("dvc", folder, [str(program), "repro", "-q"], environment)


def write_snakemake(folder: Path, program: Path, width: int = WIDTH) -> System:
    (folder / "source").write_text("nothing")
    spread = ", ".join(f'"spread-{i}"' for i in range(width))
    (folder / "Snakefile").write_text(
        f'rule last:\n    input: {spread}\n    output: "last"\n    shell: "cat {{input}} > {{output}}"\n'
        'rule spread:\n    input: "first"\n    output: "spread-{i}"\n    shell: "cat {input} > {output}"\n'
        'rule first:\n    input: "source"\n    output: "first"\n    shell: "cat {input} > {output}"\n'
    )
    return System("snakemake", folder, [str(program), "--cores", "2", "-q", "all"], _environment())


def _environment() -> dict[str, str]:
    return {"PATH": os.environ["PATH"], "HOME": os.environ.get("HOME", "/")}


def version_of(program: Path) -> str:
    return subprocess.run([program, "--version"], capture_output=True, text=True, check=True).stdout.strip()


def compare(writers: dict[str, Callable[[Path], System]], repeats: int) -> dict[str, dict[str, float]]:
    """System -> CPU and wall seconds of the first and the second run; of the repeats, that with the least CPU time."""
    best: dict[str, dict[str, float]] = {}
    for _ in range(repeats):
        for name, write in writers.items():
            with tempfile.TemporaryDirectory() as scratch:
                system = write(Path(scratch))
                for run in ("first", "second"):
                    measured = {f"{run}_{what}": round(value, 2) for what, value in system.measure().items()}
                    known = best.setdefault(name, {})
                    if measured[f"{run}_cpu_s"] <= known.get(f"{run}_cpu_s", float("inf")):
                        known |= measured
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dvc", type=Path, help="its program")
    parser.add_argument("--snakemake", type=Path, help="its program")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    writers: dict[str, Callable[[Path], System]] = {"inpaint3d": write_ours}
    versions: dict[str, str] = {}
    for name, write in (("dvc", write_dvc), ("snakemake", write_snakemake)):
        if (program := getattr(given, name)) is not None:
            program = program.absolute()
            writers[name] = lambda folder, write=write, program=program: write(folder, program)
            versions[name] = version_of(program)
    figures = {"stages": WIDTH + 2, "versions": versions, "systems": compare(writers, given.repeats)}
    text = json.dumps(figures | commit(), indent=2) + "\n"
    sys.stdout.write(text)
    if given.out is not None:
        given.out.write_text(text)


if __name__ == "__main__":
    main()
