import pytest

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


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        ("avx2 fma sse", "avx2"),
        ("avx512f avx512dq avx512vl avx512bw fma avx2", "avx512"),
        ("amx_bf16 avx512f avx512dq avx512vl avx512bw fma avx2", "amx"),
        ("sse2 avx2", ""),
    ],
)
def test_the_widest_vectors_of_a_processor(flags, name):
    assert keys.name_widest_vectors(set(flags.split())) == name


def test_the_instruction_set_counts_where_something_is_computed():
    assert "instruction_set" in keys.key_components(SPEC, **BASE)
    assert "instruction_set" not in keys.key_components(SPEC, **BASE, stub=True)
