"""Emitted manifests: golden, checked in four layers, and executed."""

import copy
import json
import re

import pytest
import yaml

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.configure import configure_submission
from inpaint3d.orchestrator.emit.argo import LEFT_OUT, emit
from inpaint3d.orchestrator.emit.check import check
from inpaint3d.orchestrator.emit.documents import check_types, dump
from inpaint3d.orchestrator.emit.pods import RETRY
from tests.conftest import REPOSITORY
from tests.kubernetes.manifests import HERE, TOY, cluster, golden, submission
from tests.kubernetes.simulator import PAST_DEADLINE, Pod, evaluate

PIPELINE = Pipeline(REPOSITORY / "pipeline.yaml")


@pytest.fixture(scope="module")
def emitted():
    return emit(TOY, cluster(credentialsSecret="s3"), submission(TOY, awaitMasks=True))


@pytest.mark.parametrize("file", sorted(golden()))
def test_manifests_are_the_golden_ones(file):
    """After a change that is meant: python -m tests.kubernetes.manifests, and read the difference."""
    assert golden()[file] == (HERE / "golden" / file).read_text()


@pytest.mark.parametrize("preset", PIPELINE.spec.spec.presets)
def test_the_whole_pipeline_passes_every_layer(preset):
    asked = submission(PIPELINE, preset=preset, device="cuda", awaitMasks=True)
    documents = emit(PIPELINE, cluster(), asked)
    assert check(documents, PIPELINE) == []
    assert list(yaml.safe_load_all(dump(documents))) == documents
    template = template_of(documents)["spec"]["templates"]
    configured = configure_submission(PIPELINE, asked)
    assert {t["name"] for t in template} == {"scenes", "scene", "await-mask", "record", *configured.pipeline.order}
    assert json.loads(template_of(documents)["metadata"]["annotations"][LEFT_OUT]) == configured.left_out != {}


def test_paintings_are_awaited_once_before_the_first_node_that_reads_them():
    asked = submission(PIPELINE, awaitPaintings=True, want=("plate-export",))
    documents = emit(PIPELINE, cluster(), asked)
    assert check(documents, PIPELINE) == []
    (scene,) = [t for t in template_of(documents)["spec"]["templates"] if t["name"] == "scene"]
    tasks = {task["name"]: task for task in scene["dag"]["tasks"]}
    upstream = configure_submission(PIPELINE, asked).pipeline.upstream("view-completion")
    assert set(tasks["await-painting"]["dependencies"]) == upstream
    for node in ("view-completion", "plate-export"):
        assert "await-painting" in tasks[node]["dependencies"]
        values = {p["name"]: p["value"] for p in tasks[node]["arguments"]["parameters"]}
        assert values["painted-views"] == "{{tasks.await-painting.outputs.parameters.painted-views}}"


def test_a_node_of_a_preset_alone_has_its_seed():
    asked = submission(PIPELINE, preset="creative", seed=10, overrides={"evaluation": {"seed": 4}})
    template = template_of(emit(PIPELINE, cluster(), asked))
    seeds = {}
    for stage in template["spec"]["templates"]:
        for artifact in stage.get("inputs", {}).get("artifacts", []):
            seeds[stage["name"]] = json.loads(artifact["raw"]["data"])["seed"]
    assert (seeds["joint-optimization"], seeds["second-completion"], seeds["third-completion"]) == (10, 11, 12)
    assert seeds.pop("evaluation") == 4
    assert set(seeds.values()) == {10, 11, 12}
    assert seeds["usd-export"] == 10


def test_hera_gives_back_what_was_emitted(emitted):
    typed = [d for d in emitted if d["kind"].startswith("Workflow")]
    assert [check_types(copy.deepcopy(d)) for d in typed] == typed
    assert [d["kind"] for d in emitted if d not in typed] == ["ServiceAccount", "Role", "RoleBinding"]


def test_an_account_that_is_there_is_named_and_not_written():
    documents = emit(TOY, cluster(createServiceAccount=False, serviceAccountName="robot"), submission(TOY))
    assert [d["kind"] for d in documents] == ["WorkflowTemplate", "Workflow"]
    assert documents[0]["spec"]["serviceAccountName"] == "robot"
    assert check(documents, TOY) == []


@pytest.mark.parametrize(("largest", "asked"), [("1500m", "1500m"), ("1", "1"), ("8", "2")])
def test_no_pod_asks_for_more_than_a_small_node_has(largest, asked):
    documents = emit(PIPELINE, cluster(largestCpuRequest=largest), submission(PIPELINE))
    resources = _container(documents, "pose-estimation")["resources"]
    assert (resources["requests"]["cpu"], resources["limits"]["cpu"]) == (asked, "2")


def test_names_that_yaml_would_read_as_booleans_are_quoted():
    text = golden()["cuda-await-masks.yaml"]
    assert 'accelerator: "n"' in text
    assert re.search(r'name: "n"\n', text)
    assert not re.search(r": (n|y|yes|no|on|off)$", text, re.MULTILINE | re.IGNORECASE)


def test_many_scenes_become_workflows_of_a_few():
    workflows = [d for d in emit(TOY, cluster(scenesPerWorkflow=1), submission(TOY)) if d["kind"] == "Workflow"]
    assert [w["metadata"]["name"] for w in workflows] == ["test-0000", "test-0001"]
    (value,) = [p["value"] for p in workflows[1]["spec"]["arguments"]["parameters"]]
    assert [s["name"] for s in json.loads(value)] == ["n"]


def test_an_image_that_was_not_built_is_named():
    built = submission(TOY)
    without = {n: i for n, i in built.images.items() if n != "toy/field"}
    with pytest.raises(ConfigurationError, match="no toy/field; run `make images`"):
        emit(TOY, cluster(), built.model_copy(update={"images": without}))


@pytest.mark.parametrize(
    ("phase", "code", "message", "again"),
    [("Error", "-1", "pod deleted", True), ("Failed", "75", "", True), ("Failed", "143", "", True),
     ("Failed", "-1", "The node was low on resource: memory.", True), ("Failed", "-1", PAST_DEADLINE, False),
     ("Failed", "143", PAST_DEADLINE, False), ("Failed", "2", "", False), ("Failed", "3", "", False),
     ("Failed", "137", "OOMKilled (exit code 137)", False), ("Failed", "1", "", False)],
)  # fmt: skip
def test_only_lost_pods_and_retryable_exits_are_tried_again(phase, code, message, again):
    assert evaluate(RETRY, Pod("", phase, code, "", message)) is again


def template_of(documents):
    return next(d for d in documents if d["kind"] == "WorkflowTemplate")


def _patch_pods(documents, kind, **security):
    spec = template_of(documents)["spec"]
    patch = json.loads(spec["podSpecPatch"])
    patch[kind][0]["securityContext"].update(security)
    spec["podSpecPatch"] = json.dumps(patch)


def _template(documents, name):
    return next(t for t in template_of(documents)["spec"]["templates"] if t["name"] == name)


def _task(documents, name):
    return next(t for t in _template(documents, "scene")["dag"]["tasks"] if t["name"] == name)


def _replace(documents, name, old, new):
    """Replace in a template's text."""
    templates = template_of(documents)["spec"]["templates"]
    i = next(i for i, t in enumerate(templates) if t["name"] == name)
    text = json.dumps(templates[i])
    assert old in text
    templates[i] = json.loads(text.replace(old, new))


def _drop(items, name):
    items[:] = [i for i in items if i["name"] != name]


def _arguments(documents, task):
    return _task(documents, task)["arguments"]["parameters"]


def _container(documents, name):
    return _template(documents, name)["container"]


def _scenes(documents, value):
    documents[-1]["spec"]["arguments"]["parameters"][0]["value"] = value


TRUTH, FED = "outputs.parameters.truth", '\\"capture\\": \\"{{inputs.parameters.capture}}\\", '
PINNED = submission(TOY).images["toy/field"].digest
KEY = {"name": "AWS_SECRET_ACCESS_KEY", "value": "x"}
MUTATIONS = {
    "types": {
        "a typo in a field": lambda d: _container(d, "a").update(comand=["x"]),
        "a field of the wrong type": lambda d: template_of(d)["spec"].update(parallelism="many"),
        "a list where Argo wants text": lambda d: _task(d, "a").update(template=["a"]),
        "an unknown kind": lambda d: d[-1].update(kind="Workflo"),
    },
    "references": {
        "a task of no template": lambda d: _task(d, "a").update(template="b"),
        "a placeholder of no output": lambda d: _replace(d, "scene", TRUTH, "outputs.parameters.thruth"),
        "a placeholder of no input": lambda d: _replace(d, "scene", "{{inputs.parameters.capture", "{{inputs.photos"),
        "a circle": lambda d: _task(d, "ingest").update(dependencies=["score"]),
        "reading without waiting": lambda d: _task(d, "score").update(dependencies=["a"]),
        "waiting for no task": lambda d: _task(d, "score").update(dependencies=["a", "n", "m"]),
        "an argument left out": lambda d: _drop(_arguments(d, "a"), "capture"),
        "an entrypoint that is not there": lambda d: template_of(d)["spec"].update(entrypoint="main"),
        "a volume that is not there": lambda d: _drop(template_of(d)["spec"]["volumes"], "tmp"),
        "another WorkflowTemplate": lambda d: d[-1]["spec"]["workflowTemplateRef"].update(name="tset"),
        "a scene without its capture": lambda d: _scenes(d, '[{"name": "a"}]'),
    },
    "contracts": {
        "a missing port": lambda d: _replace(d, "a", FED, ""),
        "a port that no stage has": lambda d: _replace(d, "a", FED, FED.replace("capture", "frames", 1)),
        "a wrong schema major": lambda d: _replace(d, "ingest", "capture@1.0", "capture@2.0"),
        "another version of a stage": lambda d: _replace(d, "a", "field@0.1.0", "field@0.2.0"),
        "a wrong parameter": lambda d: _replace(d, "n", '\\"steps\\": 20', '\\"stesp\\": 20'),
        "an output left out": lambda d: _drop(_template(d, "n")["outputs"]["parameters"], "radiance-field"),
        "a node left out": lambda d: _drop(_template(d, "scene")["dag"]["tasks"], "score"),
    },
    "policy": {
        "root": lambda d: _container(d, "a")["securityContext"].update(runAsNonRoot=False),
        "no command": lambda d: _container(d, "a").pop("command"),
        "a file that only root reads": lambda d: _template(d, "a")["inputs"]["artifacts"][0].update(mode=0o400),
        "a secret in clear": lambda d: _container(d, "a")["env"].append(KEY),
        "an image that is not pinned": lambda d: _replace(d, "a", PINNED, "latest"),
        "no memory limit": lambda d: _container(d, "a")["resources"]["limits"].pop("memory"),
        "no deadline": lambda d: _template(d, "a").pop("activeDeadlineSeconds"),
        "a deadline of all tries": lambda d: _template(d, "a")["retryStrategy"]["backoff"].update(maxDuration="10m"),
        "no request for a quota": lambda d: _container(d, "a")["resources"]["requests"].pop("cpu"),
        "added capabilities": lambda d: _container(d, "a")["securityContext"]["capabilities"].update(add=["NET_RAW"]),
        "root by number": lambda d: _container(d, "a")["securityContext"].update(runAsUser=0),
        "Argo's containers as they come": lambda d: template_of(d)["spec"].pop("podSpecPatch"),
        "Argo's init as root": lambda d: _patch_pods(d, "initContainers", runAsNonRoot=False),
        "Argo's wait without seccomp": lambda d: _patch_pods(d, "containers", seccompProfile={}),
        "a role without rights": lambda d: d[1].update(rules=[]),
        "a role for another": lambda d: d[2]["subjects"][0].update(name="other"),
        "no account": lambda d: template_of(d)["spec"].pop("serviceAccountName"),
        "another account": lambda d: d[0]["metadata"].update(name="other"),
        "Workflows that stay": lambda d: template_of(d)["spec"].pop("ttlStrategy"),
        "pods that stay": lambda d: template_of(d)["spec"].pop("podGC"),
    },
}


@pytest.mark.parametrize(("layer", "name"), [(layer, name) for layer, named in MUTATIONS.items() for name in named])
def test_a_mutated_manifest_is_refused_by_the_layer_it_offends(emitted, layer, name):
    documents = copy.deepcopy(emitted)
    MUTATIONS[layer][name](documents)
    assert documents != emitted
    findings = check(documents, TOY)
    assert any(f.startswith(f"{layer}: ") for f in findings), findings
    assert check(emitted, TOY) == []
