"""Wheels of everything, for a machine without a checkout: `python wheels/build.py OUT [OPTIONS OF uv build]`.

One wheel for each member of the workspace, and `inpaint3d`, which is made here: it asks for all of them, and lays what
a checkout has beside the code (DATA) into the same places below the namespace's folder, where the code looks for it.
Beside them lie constraints.txt, the locked versions of others' packages, and overrides.txt, what is left out of their
requirements.
"""

import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
UV = ROOT / ".cache" / "uv-home" / "bin" / "uv"
DATA = (
    "pipeline.yaml",
    "study.yaml",
    "stages/*/stage.yaml",
    "schemas/parameters/*.json",
    "priors/general/*",
    "benchmarks/results/study/demo/points.json",  # what `--time-budget` chooses from
)
PROJECT = """\
[project]
name = "{name}"
version = "{version}"
description = "{description}"
license = "{license}"
requires-python = "{requires-python}"
dependencies = [{members}]

[build-system]
requires = ["uv_build>=0.8"]
build-backend = "uv_build"

[tool.uv.build-backend]
namespace = true
"""


def main() -> None:
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    out, options = Path(sys.argv[1]).resolve(), sys.argv[2:]
    out.mkdir(parents=True, exist_ok=True)
    build = ("build", "--quiet", "--wheel", "--out-dir", str(out), *options)
    _run(*build, "--all-packages")
    with tempfile.TemporaryDirectory() as folder:
        write_project(Path(folder))
        _run(*build, folder)
    overrides = _read(ROOT / "pyproject.toml")["tool"]["uv"]["override-dependencies"]
    (out / "overrides.txt").write_text("\n".join(overrides) + "\n")
    locked = ("--locked", "--all-packages", "--no-emit-workspace", "--no-hashes", "--no-dev")
    _run("export", "--quiet", *locked, "--output-file", str(out / "constraints.txt"))


def write_project(folder: Path) -> None:
    """The source of the package `inpaint3d`: a pyproject.toml, and the files that DATA names."""
    members = [_read(path)["project"] for path in list_members()]
    needs = ", ".join(f'"{m["name"]}=={m["version"]}"' for m in members)
    project = _read(ROOT / "pyproject.toml")["project"]
    (folder / "pyproject.toml").write_text(PROJECT.format_map({**project, "members": needs}))
    for path in (path for pattern in DATA for path in ROOT.glob(pattern)):
        target = folder / "src" / project["name"] / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)


def list_members() -> list[Path]:
    """The pyproject.toml of each member of the workspace."""
    members = _read(ROOT / "pyproject.toml")["tool"]["uv"]["workspace"]["members"]
    return sorted(path for pattern in members for path in ROOT.glob(f"{pattern}/pyproject.toml"))


def _read(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text())


def _run(*arguments: str) -> None:
    subprocess.run([str(UV), *arguments], cwd=ROOT, check=True)


if __name__ == "__main__":
    main()
