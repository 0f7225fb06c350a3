"""The published JSON Schemas (2020-12), generated from the models.

python -m inpaint3d.contracts.schemas [--check]
"""

import importlib
import json
import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from inpaint3d.contracts.models.artifacts import SCHEMAS
from inpaint3d.contracts.models.cluster import ClusterSpec, ImagesSpec
from inpaint3d.contracts.models.manifest import Manifest
from inpaint3d.contracts.models.pipeline import PipelineSpec
from inpaint3d.contracts.models.report import RunReport
from inpaint3d.contracts.models.stage import StageSpec, load_stage

ID_BASE = "urn:inpaint3d:schema:"


def build_schema(model: type[BaseModel], name: str, version: str) -> dict[str, Any]:
    """A model's schema under an immutable `$id` that carries the full version."""
    schema = model.model_json_schema(by_alias=True, mode="validation")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"{ID_BASE}{name}:{version}",
        **schema,
    }


def build_schemas(repository: Path) -> dict[Path, dict[str, Any]]:
    """Path below `schemas/` -> schema, for documents, artifacts, and every stage's parameters."""
    found: dict[Path, dict[str, Any]] = {
        Path("pipeline/1.json"): build_schema(PipelineSpec, "pipeline", "1"),
        Path("stage/1.json"): build_schema(StageSpec, "stage", "1"),
        Path("artifact/1.json"): build_schema(Manifest, "artifact", "1"),
        Path("cluster/1.json"): build_schema(ClusterSpec, "cluster", "1"),
        Path("images/1.json"): build_schema(ImagesSpec, "images", "1"),
        Path("report/1.json"): build_schema(RunReport, "report", "1"),
    }
    for name, (version, model) in SCHEMAS.items():
        found[Path(f"artifacts/{name}/{version}.json")] = build_schema(model, f"artifacts:{name}", version)
    for path in sorted(repository.glob("stages/*/stage.yaml")):
        spec = load_stage(path)
        config: type[BaseModel] = importlib.import_module(f"{spec.spec.module}.config").Config
        name = spec.metadata.name
        found[Path(f"parameters/{name}.json")] = build_schema(config, f"parameters:{name}", spec.metadata.version)
    return found


def main(arguments: list[str]) -> int:
    """Write `schemas/`, or with --check say what differs and return 1."""
    repository = Path.cwd()
    stale: list[str] = []
    for relative, schema in build_schemas(repository).items():
        path = repository / "schemas" / relative
        text = json.dumps(schema, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
        if path.is_file() and path.read_text() == text:
            continue
        stale.append(str(path.relative_to(repository)))
        if "--check" not in arguments:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    if stale and "--check" in arguments:
        sys.stderr.write("schemas differ from the models (run `make schemas`): " + ", ".join(stale) + "\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
