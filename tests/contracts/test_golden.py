"""Golden instances of every released schema version validate for ever, by the published schema and by the model."""

import json
from pathlib import Path

import jsonschema
import pytest

from inpaint3d.contracts.models.artifacts import SCHEMAS
from inpaint3d.contracts.models.manifest import Manifest, read_metadata
from tests.conftest import REPOSITORY

SCHEMA_FOLDER = REPOSITORY / "schemas" / "artifacts"
GOLDEN = sorted((REPOSITORY / "schemas" / "golden").glob("*/*.json"))


@pytest.mark.parametrize("path", GOLDEN, ids=lambda p: f"{p.parent.name}@{p.stem}")
def test_golden_instance_validates(path: Path):
    value = json.loads(path.read_text())
    schema = json.loads((SCHEMA_FOLDER / path.parent.name / path.name).read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(value["metadata"], schema, cls=jsonschema.Draft202012Validator)
    jsonschema.validate(value, json.loads((REPOSITORY / "schemas" / "artifact" / "1.json").read_text()))
    manifest = Manifest.model_validate(value)
    read_metadata(manifest, SCHEMAS[path.parent.name][1])
    assert manifest.schema_id == f"{path.parent.name}@{path.stem}"


@pytest.mark.parametrize("path", GOLDEN, ids=lambda p: f"{p.parent.name}@{p.stem}")
def test_the_published_schema_is_closed(path: Path):
    value = json.loads(path.read_text())["metadata"] | {"no_such_field": 1}
    schema = json.loads((SCHEMA_FOLDER / path.parent.name / path.name).read_text())
    with pytest.raises(jsonschema.ValidationError, match="no_such_field"):
        jsonschema.validate(value, schema)


def test_every_version_has_a_golden_instance_and_an_immutable_id():
    versions = {(p.parent.name, p.stem) for p in SCHEMA_FOLDER.glob("*/*.json")}
    assert versions == {(p.parent.name, p.stem) for p in GOLDEN}
    assert {(name, version) for name, (version, _) in SCHEMAS.items()} <= versions
    for name, version in versions:
        schema = json.loads((SCHEMA_FOLDER / name / f"{version}.json").read_text())
        assert schema["$id"].endswith(f":{name}:{version}")
