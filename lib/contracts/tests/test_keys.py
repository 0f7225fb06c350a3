import importlib.metadata

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit import keys
from inpaint3d.contracts.models.stage import StageSpec

SPEC = StageSpec.model_validate(
    {
        "apiVersion": "inpaint3d/v1",
        "kind": "Stage",
        "metadata": {"name": "toy", "version": "0.1.0"},
        "spec": {
            "description": "a toy",
            "image": "inpaint3d/toy",
            "module": "inpaint3d.stages.toy",
            "inputs": {"source": {"schema": "source@1"}},
            "outputs": {"effect-plan": {"schema": "effect-plan@1.0"}},
        },
    }
)
D = "sha256:" + "a" * 64
BASE = {"code": D, "parameters": {"a": 1}, "inputs": {"source": D}, "seed": 0, "device": "cpu"}


def key(**changes):
    return keys.run_key(keys.key_components(SPEC, **{**BASE, **changes}))


def test_same_components_same_key():
    assert key() == key(parameters={"a": 1})


@pytest.mark.parametrize(
    "change",
    [
        {"code": "sha256:" + "b" * 64},
        {"parameters": {"a": 2}},
        {"inputs": {}},
        {"seed": 1},
        {"device": "cuda"},
        {"stub": True},
    ],
)
def test_every_component_counts(change):
    assert key(**change) != key()


def test_the_image_digest_stands_for_the_code(monkeypatch):
    monkeypatch.setenv(keys.IMAGE_DIGEST, D)
    assert keys.code_digest("inpaint3d.stages.whatever") == D


def test_local_code_digest_covers_libraries_but_not_other_packages():
    closure = keys._closure("inpaint3d-scene")
    assert {"inpaint3d-scene", "inpaint3d-contracts", "numpy", "pydantic"} <= closure
    assert not {"torch", "inpaint3d-radiance"} & closure


def test_compiled_sources_count_and_reach_the_stages_that_compute_with_them(monkeypatch):
    assert "inpaint3d-kernels" in keys._closure("inpaint3d-nerf-pretraining")
    seen = []
    monkeypatch.setattr(keys, "tree_digest", lambda folder, _: seen.append(folder.name) or D)
    keys._source_digest.__wrapped__("inpaint3d-kernels")
    assert seen == ["src", "csrc"]
    assert {".cpp", ".hpp"} <= set(keys.SOURCE_SUFFIXES)


def test_a_distribution_that_is_not_here_is_a_clear_error():
    with pytest.raises(ConfigurationError, match="inpaint3d-nowhere is not installed"):
        keys.local_code_digest("inpaint3d-nowhere")


def test_versions_and_requirements_are_those_that_python_knows():
    metadata = importlib.metadata
    for name in keys._closure("inpaint3d-scene"):
        assert keys._installed(name) == (metadata.version(name), tuple(metadata.requires(name) or ()))
