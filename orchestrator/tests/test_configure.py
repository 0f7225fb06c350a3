"""A node runs only if a wanted result reads it under these parameters; what would change nothing is refused."""

import json

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.configure import Settings, configure
from inpaint3d.orchestrator.parameters import parse_overrides


def configured(toy, *assignments, given=("capture",), options=None, **settings):
    asked = Settings(overrides=parse_overrides(toy, list(assignments)), **settings)
    return configure(toy, asked, {*given, *(options or {})}, options)


def test_what_no_wanted_result_reads_is_left_out(toy):
    plain = configured(toy)
    assert plain.pipeline.order == ["ingest", "known", "join", "score"]
    assert plain.left_out == {
        "train": "nothing asks for it: join's estimator completed-views does not read prior",
        "control": "a control; --compare runs it",
    }
    assert plain.pipeline.references("join") == {
        "capture": ["ingest.capture"],
        "initial-field": ["known.radiance-field"],
    }
    assert plain.pipeline.references("score") == {"fields": ["join.radiance-field", "known.radiance-field"]}
    assert [(r.node, r.status) for r in plain.left_out_rows] == [("train", "left-out"), ("control", "left-out")]


def test_a_parameter_says_what_is_read(toy):
    asked = configured(toy, "join.estimator=sds")
    assert set(asked.left_out) == {"control"}
    assert asked.pipeline.references("score")["prior"] == ["train.prior"], "weak, but made anyway"
    fresh = configured(toy, "join.start=fresh")
    assert fresh.left_out["known"] == (
        "nothing asks for it: join's start fresh does not read initial-field; control, which reads it, is left out"
    )
    assert fresh.pipeline.references("score") == {"fields": ["join.radiance-field"]}


def test_of_two_ports_the_first_that_is_given_is_read(toy):
    for given, port in (((), "prior"), (("diffusers",), "diffusers")):
        asked = configured(toy, "join.estimator=sds", given=("capture", *given))
        assert {"prior", "diffusers"} & set(asked.pipeline.references("join")) == {port}
    assert asked.left_out["train"] == "nothing asks for it: join reads diffusers instead of prior"


def test_a_port_that_two_parameters_govern_is_read_if_both_say_so(toy):
    file = toy.path.parent / "schemas" / "parameters" / "join.json"
    schema = json.loads(file.read_text())
    schema["properties"]["steps"]["x-reads"] = {"10": ["initial-field"]}
    file.write_text(json.dumps(schema))
    assert "initial-field" in configured(toy).pipeline.references("join")
    for assignment, reason in (
        ("join.steps=11", "join's steps 11 does not read initial-field"),
        ("join.start=fresh", "join's start fresh does not read initial-field"),
    ):
        left = configured(toy, assignment)
        assert "initial-field" not in left.pipeline.references("join")
        assert reason in left.left_out["known"]


def test_what_is_named_is_wanted(toy):
    assert "train" in configured(toy, named=("train",)).pipeline.nodes
    compared = configured(toy, compare=True)
    assert set(compared.left_out) == {"train"}
    assert compared.pipeline.references("score")["fields"][1] == "control.radiance-field"


def test_without_wants_every_node_is_wanted_but_controls(toy):
    text = toy.path.read_text()
    toy.path.write_text(text.replace("wants: [join, score]", "wants: []"))
    assert set(configured(Pipeline(toy.path)).left_out) == {"control"}
    toy.path.write_text(text.replace("wants: [join, score]", "wants: [join, core]"))
    with pytest.raises(ConfigurationError, match=r"pipeline\.yaml:\d+: no node core; there are ingest, train"):
        Pipeline(toy.path)


def test_a_list_of_weak_references_that_nothing_fills_is_an_error(toy):
    toy.path.write_text(toy.path.read_text().replace("wants: [join, score]", "wants: [score]"))
    with pytest.raises(ConfigurationError, match=r"score: nothing at its input fields \(join\.radiance-field, "):
        configured(Pipeline(toy.path))


def test_the_whole_pipeline_is_left_as_it_was(toy):
    before = {node: toy.references(node) for node in toy.order}
    configured(toy)
    assert {node: toy.references(node) for node in toy.order} == before


def test_a_wrong_parameter_is_found_in_nodes_that_do_not_run_too(toy):
    toy.path.write_text(toy.path.read_text().replace("plain: {}", "plain: {train: {stepz: 1}}"))
    with pytest.raises(ConfigurationError, match="train has no parameter stepz"):
        configured(Pipeline(toy.path), preset="plain")


@pytest.mark.parametrize(
    ("assignments", "options", "says"),
    [
        (
            ["train.steps=3"], {},
            "--set train.steps changes nothing: train is left out (nothing asks for it: join's estimator "
            "completed-views does not read prior); --set join.estimator=VALUE (sds or nfsd) or --until train runs it",
        ),
        (["control.steps=3"], {}, "control is left out (a control; --compare runs it); --until control runs it"),
        (
            [], {"corpus": "--corpus here"},
            "--corpus here changes nothing: train, which reads it, is left out (nothing asks for it: join's estimator "
            "completed-views does not read prior); --set join.estimator=VALUE (sds or nfsd) or --until train runs it",
        ),
        (
            [], {"diffusers": "--prior sd"},
            "--prior sd changes nothing: join's estimator completed-views does not read diffusers; "
            "--set join.estimator=VALUE (sds or nfsd) does",
        ),
        ([], {"mask-request": "--mask m.yaml"}, "reads external.mask-request"),
    ],
)  # fmt: skip
def test_what_would_change_nothing_is_refused_with_the_way_out(toy, assignments, options, says):
    with pytest.raises(ConfigurationError) as error:
        configured(toy, *assignments, options=options)
    assert says in str(error.value)


def test_ports_that_x_reads_names_have_to_be_there(toy):
    file = toy.path.parent / "schemas" / "parameters" / "join.json"
    file.write_text(file.read_text().replace("diffusers|prior", "diffusers|priors"))
    with pytest.raises(ConfigurationError, match="x-reads of estimator names priors, which is no input of its stage"):
        configured(toy)


def test_a_control_that_runs_anyway_is_scored_only_where_it_is_asked_for(toy):
    """`known` is what join starts from; among the controls, evaluation sees it with --compare alone."""
    text = toy.path.read_text()
    toy.path.write_text(text.replace("compare: [control]", "compare: [known, control]"))
    again = Pipeline(toy.path)
    plain, compared = configured(again), configured(again, compare=True)
    assert "known" in plain.pipeline.nodes
    assert plain.pipeline.references("score") == {"fields": ["join.radiance-field"]}
    assert plain.pipeline.references("join")["initial-field"] == ["known.radiance-field"]
    assert "known.radiance-field" in compared.pipeline.references("score")["fields"]


def say_of(toy, words, **properties):
    """Let the schema of `join` say more of its parameters."""
    file = toy.path.parent / "schemas" / "parameters" / "join.json"
    schema = json.loads(file.read_text())
    for name, said in properties.items():
        schema["properties"][name] |= {words: said}
    file.write_text(json.dumps(schema))


def test_what_does_not_act_beside_what_is_read_is_refused(toy):
    say_of(toy, "x-without", steps="initial-field")
    configured(toy)
    assert configured(toy, "join.start=fresh", "join.steps=11").parameters["join"]["steps"] == 11
    expected = (
        r"join\.steps changes nothing where initial-field \(known\.radiance-field\) is read; "
        r"under join\.start=fresh it is not"
    )
    with pytest.raises(ConfigurationError, match=expected):
        configured(toy, "join.steps=11")


def test_what_does_not_act_under_another_parameter_s_value_is_refused(toy):
    say_of(toy, "x-unless", steps={"start": "fresh"})
    assert configured(toy, "join.steps=11").parameters["join"]["steps"] == 11
    with pytest.raises(ConfigurationError, match=r"join\.steps changes nothing under join\.start=fresh"):
        configured(toy, "join.start=fresh", "join.steps=11")


def test_what_acts_under_some_values_of_another_parameter_is_refused_under_others(toy):
    say_of(toy, "x-under", steps={"estimator.name": ["sds", "nfsd"]})
    expected = r"join\.steps changes nothing: it counts under join\.estimator\.name=sds or join\.estimator\.name=nfsd"
    with pytest.raises(ConfigurationError, match=expected):
        configured(toy, "join.steps=11")
    assert configured(toy, "join.estimator=sds", "join.steps=11").parameters["join"]["steps"] == 11


def test_the_choice_to_read_a_port_to_which_nothing_is_wired_is_refused(toy):
    say_of(toy, "x-with", start="initial-field")
    assert configured(toy, "join.start=fresh").parameters["join"]["start"] == "fresh"
    toy.path.write_text(toy.path.read_text().replace("initial-field: known.radiance-field", ""))
    with pytest.raises(ConfigurationError, match=r"join\.start changes nothing where no initial-field is wired"):
        configured(Pipeline(toy.path), "join.start=fresh")


def test_what_acts_only_beside_what_is_not_read_is_refused(toy):
    say_of(toy, "x-with", steps="initial-field")
    assert configured(toy, "join.steps=11").parameters["join"]["steps"] == 11
    with pytest.raises(ConfigurationError, match=r"join\.steps changes nothing where no initial-field is read"):
        configured(toy, "join.start=fresh", "join.steps=11")
