"""What documentation may cite: every name, file, test, command and parameter that the repository has."""

import ast
import json
import re
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import typer.main
import yaml

from inpaint3d.orchestrator.cli import add_other_commands
from tests.conftest import REPOSITORY

WORD = re.compile(r"[\w-]+")
LONGEST = 60


@cache
def tracked() -> frozenset[str]:
    """Every file and folder of the repository, as git lists them; new ones too."""
    line = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(line, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout.splitlines()
    files = [f for f in listed if (REPOSITORY / f).is_file()]
    return frozenset(files) | {str(p) for f in files for p in Path(f).parents}


@cache
def trees() -> dict[str, ast.Module]:
    return {f: ast.parse((REPOSITORY / f).read_text()) for f in tracked() if f.endswith(".py")}


def definitions(tree: ast.AST, prefix: str = "") -> set[str]:
    """Functions, classes and methods (`Class.method`, and by themselves), fields and constants of a module."""
    found: set[str] = set()
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found |= {node.name, prefix + node.name} | definitions(node, f"{node.name}.")
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)}
            found |= names | {prefix + n for n in names}
    return found


@cache
def defined() -> frozenset[str]:
    """What is defined anywhere in Python source outside tests."""
    sources = [tree for file, tree in trees().items() if "/tests/" not in f"/{file}"]
    arguments = {n.arg for tree in sources for n in ast.walk(tree) if isinstance(n, ast.arg)}
    return frozenset(arguments.union(*map(definitions, sources)))


@cache
def tests() -> frozenset[tuple[str, str]]:
    """(file stem without `test_`, test without `test_`)."""
    found: set[tuple[str, str]] = set()
    for file, tree in trees().items():
        stem = Path(file).stem
        if stem.startswith("test_"):
            names = {n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name.startswith("test_")}
            found |= {(stem.removeprefix("test_"), n.removeprefix("test_")) for n in names}
    return frozenset(found)


@cache
def values() -> frozenset[str]:
    """Short strings of the source, words of its YAML and schemas: estimators, ports, presets, keys, file names."""
    found: set[str] = set()
    for file, tree in trees().items():
        strings = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
        if "/tests/" in f"/{file}":
            found |= {s for s in strings if s.isupper()}  # variables of the environment
        else:
            found |= {s for s in strings if len(s) < LONGEST}
            found |= {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
            found |= {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)}
    for path in (REPOSITORY / file for file in tracked() if (REPOSITORY / file).is_file()):
        if path.suffix in (".yaml", ".toml", ".cpp", ".hpp") or path.name in ("Makefile", ".gitignore"):
            found |= set(WORD.findall(path.read_text()))
        elif path.suffix == ".json" and "schemas" in path.parts:
            found |= _strings(json.loads(path.read_text()))
    return frozenset(found)


def _strings(value: Any) -> set[str]:
    if isinstance(value, dict):
        return set(value).union(*map(_strings, value.values()))
    return (
        set().union(*map(_strings, value)) if isinstance(value, list) else {value} if isinstance(value, str) else set()
    )


@cache
def commands() -> dict[str, set[str]]:
    """`inpaint3d` command (`emit argo`) -> its options."""

    def walk(command: Any, name: str) -> dict[str, set[str]]:
        found = {name: {o for p in command.params for o in (*p.opts, *p.secondary_opts)}}
        for child in getattr(command, "commands", {}).values():
            found |= walk(child, f"{name} {child.name}".strip())
        return found

    return walk(typer.main.get_command(add_other_commands()), "")


@cache
def targets() -> frozenset[str]:
    makefiles = [(REPOSITORY / f).read_text() for f in tracked() if Path(f).name == "Makefile"]
    return frozenset(t for text in makefiles for t in re.findall(r"^([a-z][a-z-]*):", text, re.M))


@cache
def nodes() -> dict[str, str]:
    """Node of the pipeline -> its stage, as the schema of its parameters is called."""
    stages = yaml.safe_load((REPOSITORY / "pipeline.yaml").read_text())["spec"]["stages"]
    return {s["name"]: s["stage"].rpartition("/")[2].replace("_", "-") for s in stages}


def has_parameter(stage: str, path: str) -> bool:
    """Whether a stage's schema has a parameter, or a group's own (`architecture.levels`); `seed` is every stage's."""
    file = REPOSITORY / "schemas" / "parameters" / f"{stage}.json"
    schema = json.loads(file.read_text()) if file.is_file() else {}
    models = [schema, *schema.get("$defs", {}).values()]
    owned = {name for model in models for name in model.get("properties", {})}
    return path == "seed" or all(part in owned for part in path.split("."))
