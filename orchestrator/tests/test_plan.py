from inpaint3d.orchestrator.plan import find_differences


def test_differences_name_the_leaf_with_old_and_new():
    old = {"parameters": {"guidance": 8, "steps": 10}, "inputs": {"prior": "sha256:a"}, "seed": 0}
    new = {"parameters": {"guidance": 2, "steps": 10}, "inputs": {"prior": "sha256:b"}, "seed": 0, "stub": True}
    found = {(c.component, c.old, c.new) for c in find_differences(old, new)}
    assert found == {
        ("parameters.guidance", 8, 2),
        ("inputs.prior", "sha256:a", "sha256:b"),
        ("stub", None, True),
    }


def test_equal_components_do_not_differ():
    assert find_differences({"a": [1, {"b": 2}]}, {"a": [1, {"b": 2}]}) == ()
