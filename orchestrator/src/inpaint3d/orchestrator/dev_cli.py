"""Commands for those who work on the project itself: `inpaint3d dev`."""

import ast
import sys
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template
from typing import Annotated, cast

import typer
import yaml

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import SCHEMAS
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.options import PipelinePath
from inpaint3d.orchestrator.plan import find_pipeline

dev_app = typer.Typer(no_args_is_help=True, help="For those who work on the project itself.")

Reads = Annotated[str, typer.Option(help="what it reads: NODE.OUTPUT of the pipeline")]
Writes = Annotated[str | None, typer.Option(help="the artifact that it writes; default: the stage's name")]
Description = Annotated[str, typer.Option(help="what it does, in a few words; a capital first, no full stop")]
NEXT = """\
{folder} is a stage, and {artifact} its artifact; both are yours to fill. It stands in pipeline.yaml.
    make lock install     # the environment knows it
    make format schemas   # its schemas and a golden instance are published
    make check && .venv/bin/python -m pytest {folder}/tests
"""


@dev_app.callback()
def dev() -> None:
    """For those who work on the project itself."""


@dev_app.command(name="new-stage")
def new_stage(
    name: str,
    reads: Reads,
    writes: Writes = None,
    description: Description = "What it does, in a few words",
    pipeline: PipelinePath = None,
) -> None:
    """Write a stage that works, its tests and its artifact, and wire it in pipeline.yaml."""
    path = find_pipeline(pipeline)
    names = _fill_in_names(Pipeline(path), name, reads, writes or name, description)
    folder, artifact = (
        path.parent / "stages" / names["folder"],
        _find_artifacts(path.parent) / f"{names['schema_module']}.py",
    )
    for place in (folder, artifact):
        if place.exists():
            raise ConfigurationError(f"{place} is there already; choose another name")
    _render(files("inpaint3d.orchestrator") / "stage_template", folder, names, artifact)
    register_schema(artifact.with_name("__init__.py"), artifact.stem, names["Written"], names["writes"])
    wire(path, names["name"], names["folder"], names["port"], reads)
    shown = {"folder": folder.relative_to(path.parent), "artifact": artifact.relative_to(path.parent)}
    sys.stdout.write(NEXT.format(**shown))


def _fill_in_names(pipeline: Pipeline, name: str, reads: str, writes: str, description: str) -> dict[str, str]:
    """What the template's placeholders stand for. ConfigurationError for names that cannot be used."""
    for given in (name, writes):
        if not given.replace("-", "").isalnum() or not given[0].isalpha() or given != given.lower():
            raise ConfigurationError(f"{given!r} is no name for a stage or an artifact; take one like `relit-views`")
    if writes in SCHEMAS:
        raise ConfigurationError(f"the artifact {writes} has a schema already; name another with --writes")
    node, _, port = reads.partition(".")
    outputs = pipeline.stages[node].spec.outputs if node in pipeline.nodes else {}
    if port not in outputs:
        known = [f"{n}.{p}" for n in pipeline.order for p in pipeline.stages[n].spec.outputs]
        raise ConfigurationError(f"--reads {reads}: no such output; there are {', '.join(known)}")
    schema, _, version = outputs[port].schema_id.partition("@")
    return {
        "name": name, "folder": name.replace("-", "_"), "description": description,
        "port": port, "reads": f"{schema}@{version.partition('.')[0]}", "Read": SCHEMAS[schema][1].__name__,
        "writes": writes, "Written": "".join(part.capitalize() for part in writes.split("-")),
        "schema_module": writes.replace("-", "_"),
    }  # fmt: skip


def _find_artifacts(repository: Path) -> Path:
    """The folder of the artifacts' models in a checkout."""
    found = sorted(repository.glob("lib/contracts/src/**/artifacts/__init__.py"))
    if not found:
        raise ConfigurationError(f"{repository} is no checkout of the project; run this in one")
    return found[0].parent


def _render(template: Traversable, folder: Path, names: dict[str, str], artifact: Path) -> None:
    """Write a template's files below a folder; what is in `src` becomes the package."""
    for entry in template.iterdir():
        if entry.is_dir():
            package = folder / "src" / "inpaint3d" / "stages" / names["folder"]
            _render(entry, package if entry.name == "src" else folder / entry.name, names, artifact)
        elif entry.name.endswith(".txt"):
            target = artifact if entry.name == "artifact.py.txt" else folder / entry.name.removesuffix(".txt")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(Template(entry.read_text()).substitute(names))


def register_schema(registry: Path, module: str, model: str, schema: str) -> None:
    """Name an artifact's model in the registry: its import, its place in SCHEMAS, its export. `make format` sorts."""
    lines = registry.read_text().splitlines(keepends=True)
    package = ".".join(registry.parts[registry.parts.index("inpaint3d") : -1])
    insertions: dict[int, str] = {}
    for statement in ast.parse("".join(lines)).body:
        if isinstance(statement, ast.ImportFrom) and (statement.module or "").startswith(f"{package}."):
            insertions = {(statement.end_lineno or 0): f"from {package}.{module} import {model}\n"}
    for statement in ast.parse("".join(lines)).body:
        if isinstance(statement, (ast.Assign, ast.AnnAssign)) and isinstance(statement.value, (ast.Dict, ast.List)):
            of_schemas = isinstance(statement.value, ast.Dict)
            entry = f'    "{schema}": ("1.0", {model}),\n' if of_schemas else f'    "{model}",\n'
            insertions[(statement.end_lineno or 1) - 1] = entry
    for line, text in sorted(insertions.items(), reverse=True):
        lines.insert(line, text)
    registry.write_text("".join(lines))


def wire(pipeline: Path, name: str, folder: str, port: str, reads: str) -> None:
    """Add a node at the end of a pipeline's stages and want its result, leaving every other line as it is."""
    text = pipeline.read_text()
    spec = _find_value(cast(yaml.Node, yaml.compose(text, yaml.SafeLoader)), "spec")
    stages = cast(yaml.Node, _find_value(spec, "stages"))
    lines = text.splitlines(keepends=True)
    end = stages.end_mark.line
    while end and (not lines[end - 1].strip() or lines[end - 1].lstrip().startswith("#")):
        end -= 1
    indent = " " * (stages.start_mark.column)
    node = [f"- name: {name}", f"  stage: stages/{folder}", "  inputs:", f"    {port}: {reads}"]
    insertions = {end: "\n" + "".join(f"{indent}{line}\n" for line in node)}
    wants = _find_value(spec, "wants")
    if isinstance(wants, yaml.SequenceNode) and wants.value:
        last = cast(yaml.Node, wants.value[-1])
        if wants.flow_style:
            at, line = last.end_mark.column, lines[last.end_mark.line]
            lines[last.end_mark.line] = f"{line[:at]}, {name}{line[at:]}"
        else:
            insertions[last.end_mark.line + 1] = f"{' ' * wants.start_mark.column}- {name}\n"
    for line, addition in sorted(insertions.items(), reverse=True):
        lines.insert(line, addition)
    pipeline.write_text("".join(lines))


def _find_value(node: yaml.Node | None, key: str) -> yaml.Node | None:
    """What a mapping has under a key; None where it has none."""
    pairs = cast(list[tuple[yaml.ScalarNode, yaml.Node]], node.value if node else [])
    return next((value for name, value in pairs if name.value == key), None)
