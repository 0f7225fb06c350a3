"""Which pages the site has: the repository's Markdown where it lies, and a page for each schema of parameters.

mkdocs calls these hooks. Pages keep their paths, so that a link that works in the repository works on the site.
"""

import json
import re
import subprocess
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
SHOWN = {".md", ".png", ".jpg", ".json", ".yaml"}
FETCHED = re.compile(r"<(?:script|img|iframe)[^>]*\ssrc=.?https?:|<link[^>]*stylesheet[^>]*https?:")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """The navigation, told from the folders."""
    config.nav = [
        {"Start": ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"]},
        {"How to": _pages("docs/how-to/*.md")},
        {"Reference": [{"Stages": _pages("stages/*/README.md")}, {"Parameters": _parameter_pages()}, *_others()]},
        {"Explanation": _pages("docs/*.md")},
        {"Decisions": _pages("docs/adr/*.md")},
    ]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Every tracked file that a page shows or links to, under its path in the repository."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    found = Files([file for file in files if file.src_dir != config.docs_dir])  # those of the theme
    for path in listed:
        if Path(path).suffix in SHOWN and (ROOT / path).is_file():
            found.append(File(path, str(ROOT), config.site_dir, use_directory_urls=False))
    for page in _parameter_pages():
        schema = json.loads((ROOT / page).with_suffix(".json").read_text())
        found.append(File.generated(config, page, content=parameter_page(Path(page).stem, schema)))
    return found


def on_post_page(output: str, **_rest: Any) -> str:
    """PluginError where a page would fetch something when it is read."""
    if found := FETCHED.search(output):
        raise PluginError(f"a page fetches from the network: {found.group(0)}; keep a copy in docs/ instead")
    return output


def parameter_page(stage: str, schema: dict[str, Any]) -> str:
    """A stage's parameters as tables: its own, then those of each model that they refer to."""
    lines = [f"# Parameters of {stage}", "", schema.get("description", ""), "", *_table(schema)]
    for name, model in schema.get("$defs", {}).items():
        if "properties" in model:
            lines += ["", f"## {name}", "", model.get("description", ""), "", *_table(model)]
    return "\n".join([*lines, "", f"From [{stage}.json]({stage}.json).", ""])


def _table(model: dict[str, Any]) -> list[str]:
    rows = ["| parameter | type | default | |", "|---|---|---|---|"]
    for name, field in model.get("properties", {}).items():
        default = f"`{json.dumps(field['default'])}`" if "default" in field else ""
        cells = [f"`{name}`", _type(field), default, field.get("description", "")]
        rows.append("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |")
    return rows


def _type(field: dict[str, Any]) -> str:
    """A JSON Schema type in words."""
    if "$ref" in field:
        return field["$ref"].rpartition("/")[2]
    if options := field.get("anyOf") or field.get("oneOf"):
        return " or ".join(map(_type, options))
    if "enum" in field:
        return ", ".join(map(json.dumps, field["enum"]))
    return json.dumps(field["const"]) if "const" in field else field.get("type", "")


def _pages(pattern: str) -> list[str]:
    return [str(path.relative_to(ROOT)) for path in sorted(ROOT.glob(pattern))]


def _parameter_pages() -> list[str]:
    return [str(Path(path).with_suffix(".md")) for path in _pages("schemas/parameters/*.json")]


def _others() -> list[str]:
    folders = ("containers", "priors", "lib/*", "examples/*")
    return [page for folder in folders for page in _pages(f"{folder}/README.md")]
