"""The whole DAG with stubs: scheduling, keys, reasons and results, in seconds and without numeric work."""

import html
import importlib
import json
import shutil

import jsonschema
import pytest

from inpaint3d.contracts.models.pipeline import Pipeline, merge_parameters
from inpaint3d.contracts.store import FolderStore
from inpaint3d.contracts.store.artifact import hex_of
from inpaint3d.orchestrator.configure import Settings, configure
from inpaint3d.orchestrator.parameter_schema import parameter_schema
from inpaint3d.orchestrator.parameters import combine_parameters
from tests.conftest import REPOSITORY

WHOLE = Pipeline(REPOSITORY / "pipeline.yaml")
PIPELINE = WHOLE.under("standard")
DEFAULT = configure(WHOLE, Settings("standard"), {"capture", "mask-request", "pretrained-prior"})
MASK = "mask: {kind: sphere, centre: [0, 0, 0], radius: 0.3}\n"


@pytest.fixture
def ran(cli, capture, tmp_path):
    """One whole run of stubs."""
    (tmp_path / "mask.yaml").write_text(MASK)
    arguments = ("run", str(capture), "--stub", "--mask", str(tmp_path / "mask.yaml"))
    result = cli(*arguments)
    assert result.returncode == 0, result.stderr + result.stdout
    return cli, arguments


def test_a_run_leaves_results_then_has_nothing_to_do_then_reruns_what_changed(ran):
    cli, arguments = ran
    folder = cli.runs / "tiny"
    assert {"report.html", "scene.usdz", "metrics.json", "pictures"} <= {p.name for p in folder.iterdir()}
    states = cli.statuses()
    assert {n: s for n, s in states.items() if s != "done"} == dict.fromkeys(DEFAULT.left_out, "left-out")
    schema = json.loads((REPOSITORY / "schemas" / "report" / "1.json").read_text())
    jsonschema.validate(json.loads((folder / "metrics.json").read_text()), schema)
    assert cli("show", "tiny", "--json").stdout == (folder / "metrics.json").read_text()

    again = cli(*arguments)
    assert "nothing to be done" in again.stderr
    assert set(cli.statuses().values()) == {"cached", "left-out"}

    changed = cli(*arguments, "--set", "joint-optimization.estimator.weight=2")
    assert changed.returncode == 0, changed.stderr
    states = cli.statuses()
    assert states["joint-optimization"] == "done"
    behind = {"joint-optimization", *PIPELINE.downstream("joint-optimization")}
    # Stubs ignore weights, so what they write is the same and the cut-off is early: nothing behind runs again.
    assert all(states[n] == "cached" for n in DEFAULT.pipeline.order if n not in behind)
    assert states["evaluation"] == "cached"
    why = cli("why", "tiny", "joint-optimization").stdout
    assert "parameters.estimator.weight" in why
    assert "-> 2" in why

    wanted = cli(*arguments, "--want", "splat-export")
    assert wanted.returncode == 0, wanted.stderr
    splats = {path.name for path in (folder / "splats").iterdir()}
    assert splats == {"splats.ply", "splats.spz", "splats.glb", "splats.usdc"}


def test_a_doubtful_result_stops_the_run_unless_a_person_insists(ran):
    cli, arguments = ran
    assert "These results are doubtful" not in (cli.runs / "tiny" / "report.html").read_text()
    store = FolderStore(cli.store)
    (record,) = (r for r in store.records() if r.stage.startswith("nerf-pretraining"))
    doubtful = record.model_copy(update={"timings": {**record.timings, "doubts": ["12 dB on views held out"]}})
    (cli.store / "keys" / f"{hex_of(record.key)}.json").write_bytes(doubtful.encode())

    stopped = cli(*arguments)
    assert stopped.returncode == 6
    assert "nerf-pretraining failed: 12 dB on views held out. The result is kept: --accept-doubtful" in stopped.stderr
    assert cli.statuses()["mask-authoring"] == "pending"
    doubts = ["nerf-pretraining: 12 dB on views held out"]
    assert json.loads((cli.runs / "tiny" / "metrics.json").read_text())["doubts"] == doubts

    assert cli(*arguments, "--accept-doubtful").returncode == 0
    assert set(cli.statuses().values()) == {"cached", "left-out"}, "nothing is computed again"
    page = (cli.runs / "tiny" / "report.html").read_text()
    assert doubts[0] in page.partition("<main>")[2].partition("<h1>")[0], "before all the rest"


def test_a_preset_may_have_nodes_of_its_own(ran):
    cli, arguments = ran
    assert cli(*arguments, "--name", "varied", "--preset", "creative").returncode == 0
    states = cli.statuses("varied")
    assert set(states) == set(WHOLE.order) > set(PIPELINE.order)
    assert states["second-completion"] == states["third-completion"] == "done"
    assert states["diffusion-training"] == states["continued-reconstruction"] == "left-out"
    (record,) = (cli.store / "runs" / "varied").glob("*.json")
    evaluation = next(n for n in json.loads(record.read_text())["nodes"] if n["node"] == "evaluation")
    assert len(evaluation["components"]["inputs"]["radiance-fields"]) == 3


def test_one_stage_can_have_a_seed_of_its_own(ran):
    cli, arguments = ran
    assert cli(*arguments, "--set", "joint-optimization.seed=3").returncode == 0
    assert next(n for n, s in cli.statuses().items() if s == "done") == "joint-optimization"
    assert "seed: 0 -> 3" in cli("why", "tiny", "joint-optimization").stdout


def test_two_runs_are_compared_by_what_they_made(ran):
    cli, arguments = ran
    assert cli(*arguments, "--name", "again").returncode == 0
    same = cli("compare", "tiny", "again")
    assert same.returncode == 0, same.stdout
    assert same.stdout.count("equal") >= len(DEFAULT.pipeline.order)
    assert cli(*arguments, "--name", "seeded", "--seed", "1").returncode == 0
    other = cli("compare", "tiny", "seeded")
    assert other.returncode == 3
    assert "was asked something else" in other.stdout


def test_plan_gives_reasons_without_running(ran):
    cli, arguments = ran
    rows = json.loads(cli("plan", *arguments[1:], "--set", "joint-optimization.estimator.weight=2", "--json").stdout)
    planned = {r["node"]: r for r in rows}
    assert planned["joint-optimization"]["status"] == "pending"
    assert [c["component"] for c in planned["joint-optimization"]["changes"]] == ["parameters.estimator.weight"]
    assert planned["nerf-pretraining"]["status"] == "cached"
    assert planned["evaluation"]["reason"] == "after joint-optimization"
    assert len(json.loads(cli("runs", "--json").stdout)) == 1


def test_selection(ran):
    cli, arguments = ran
    cli(*arguments, "--only", "scene-analysis", "--force")
    assert [n for n, s in cli.statuses().items() if s == "done"] == ["scene-analysis"]
    cli(*arguments, "--from", "evaluation", "--force")
    assert {n for n, s in cli.statuses().items() if s == "done"} == {"evaluation"}
    assert cli(*arguments, "--only", "nothing").returncode == 2


def test_until_stops_there(cli, capture):
    result = cli("run", str(capture), "--stub", "--until", "scene-analysis")
    assert result.returncode == 0, result.stderr
    states = cli.statuses()
    assert {n for n, s in states.items() if s == "done"} == {"capture-ingest", "pose-estimation", "scene-analysis"}
    assert states["nerf-pretraining"] == "skipped"


def test_a_stage_alone_whose_inputs_are_not_there_says_so(cli, capture):
    result = cli("run", str(capture), "--stub", "--only", "evaluation")
    assert result.returncode == 2
    assert "evaluation (after " in result.stderr


def test_decisions_on_effects_are_in_metrics_and_shown(ran):
    cli, _ = ran
    effects = json.loads((cli.runs / "tiny" / "metrics.json").read_text())["effects"]
    assert {e["effect"]["name"]: e["effect"]["state"] for e in effects}["exposure"] == "off"
    shown = cli("show", "tiny")
    assert shown.returncode == 0
    assert "view-dependence" in shown.stdout


def test_a_plan_of_effects_stops_after_the_analysis(cli, capture):
    result = cli("plan", str(capture), "--stub", "--effects", "--effect", "exposure=on", "--name", "asked")
    assert result.returncode == 0, result.stderr
    assert "forced-on" in result.stdout
    states = cli.statuses("asked")
    assert states["scene-analysis"] == "done"
    assert states.get("nerf-pretraining") in (None, "skipped", "pending")


def test_a_damaged_artifact_is_found_and_computed_again(ran):
    cli, arguments = ran
    report = json.loads((cli.runs / "tiny" / "metrics.json").read_text())
    stage = next(s for s in report["stages"] if s["node"] == "scene-analysis")
    digest = stage["outputs"]["effect-plan"].removeprefix("sha256:")
    manifest = cli.store / "objects" / digest / "artifact.json"
    manifest.chmod(0o644)
    manifest.write_text(manifest.read_text().replace("off", "on ", 1))
    assert cli("verify").returncode == 3
    assert cli(*arguments).returncode == 0
    assert {n for n, s in cli.statuses().items() if s == "done"} == {"scene-analysis"}
    assert cli("verify").returncode == 0


def test_a_bucket_serves_as_the_store(cli, capture, bucket, tmp_path):
    """Stages, results, history and housekeeping, with nothing kept on this machine but a cache that may be lost."""
    cli.store = bucket
    (tmp_path / "mask.yaml").write_text(MASK)
    arguments = ("run", str(capture), "--stub", "--mask", str(tmp_path / "mask.yaml"))
    first = cli(*arguments)
    assert first.returncode == 0, first.stderr + first.stdout
    assert {"report.html", "scene.usdz", "metrics.json"} <= {p.name for p in (cli.runs / "tiny").iterdir()}
    shutil.rmtree(tmp_path / "cache")
    assert "nothing to be done" in cli(*arguments).stderr
    assert len(json.loads(cli("runs", "--json").stdout)) == 2
    assert cli("lineage", "tiny").stdout.startswith("usd-export@")
    assert cli("gc").returncode == 0
    assert cli("verify").returncode == 0
    assert "nothing to be done" in cli(*arguments).stderr


def test_lineage_leads_back_to_the_photos_and_gc_keeps_what_is_needed(ran):
    cli, arguments = ran
    lines = cli("lineage", "tiny").stdout
    assert lines.startswith("usd-export@")
    assert "source: capture" in lines
    assert cli("gc").returncode == 0
    assert cli("lineage", "tiny").stdout == lines
    assert "nothing to be done" in cli(*arguments).stderr


def test_gc_keeps_the_last_whole_run_when_a_later_one_did_not_end(ran):
    cli, arguments = ran
    whole = next((cli.store / "runs" / "tiny").glob("*.json"))
    early = json.loads(whole.read_text()) | {"id": "000002-29991231T000000-dead", "status": "running", "nodes": []}
    del early["digest"]
    (whole.parent / f"{early['id']}.json").write_text(json.dumps(early))
    assert cli("gc").returncode == 0
    assert "nothing to be done" in cli(*arguments).stderr


def test_the_map_shows_every_node_and_what_it_leads_to():
    words = (REPOSITORY / "ARCHITECTURE.md").read_text()
    picture = words.split("```")[1]
    assert [n for n in PIPELINE.order if n not in picture] == []


def test_names_of_runs_are_folders_below_the_results(cli, tmp_path):
    folder = tmp_path / "my.photos.v2"
    folder.mkdir()
    (folder / "note.txt").write_text("stubs do not look")
    assert cli("run", str(folder), "--stub", "--until", "capture-ingest").returncode == 0
    assert (cli.runs / "my.photos.v2" / "metrics.json").is_file()
    for name in ("../elsewhere", "..", ""):
        result = cli("run", str(folder), "--stub", "--name", name)
        assert result.returncode == 2
        assert "--name" in result.stderr


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--only", "evaluation", "--until", "evaluation"), "neither --from nor --until"),
        (("--from", "evaluation", "--until", "capture-ingest"), "no stage lies between"),
        (("--log-format", "xml"), "'xml' is not one of"),
        (("--device", "tpu"), "'tpu' is not one of"),
    ],
)
def test_options_that_make_no_sense_together_or_alone(cli, capture, options, says):
    result = cli("run", str(capture), "--stub", *options)
    assert result.returncode == 2
    assert says in result.stderr
    assert not (cli.store / "runs").exists()
    assert not (cli.store / "objects").exists() or not list((cli.store / "objects").iterdir()), "nothing was taken in"


def test_json_lines_are_json(cli, capture):
    result = cli("run", str(capture), "--stub", "--until", "capture-ingest", "--log-format", "json")
    events = [json.loads(line) for line in result.stdout.splitlines()]
    assert [e["status"] for e in events if e.get("event") == "stage" and e["stage"] == "capture-ingest"] == [
        "running", "done",
    ]  # fmt: skip


def test_scenes_fan_out(cli, tmp_path):
    for scene in ("a", "b"):
        (tmp_path / "all" / scene).mkdir(parents=True)
        (tmp_path / "all" / scene / "note.txt").write_text(scene)
    scenes = ("--scene", "a", "--scene", "b")
    assert cli("run", str(tmp_path / "all"), "--stub", "--until", "scene-analysis", *scenes).returncode == 0
    assert {r["name"] for r in json.loads(cli("runs", "--json").stdout)} == {"a", "b"}
    missing = cli("run", str(tmp_path / "all"), "--stub", "--scene", "c")
    assert missing.returncode == 2
    assert "there is no" in missing.stderr


@pytest.mark.parametrize("preset", WHOLE.spec.spec.presets)
@pytest.mark.parametrize("node", WHOLE.order)
def test_every_preset_has_valid_parameters(preset, node):
    chosen = WHOLE.parameters(node, preset)
    whole = combine_parameters(WHOLE, node, preset, {})
    assert merge_parameters(whole, chosen) == whole
    config = importlib.import_module(f"{WHOLE.stages[node].spec.module}.config").Config
    assert whole == config.model_validate(chosen).model_dump(mode="json"), "defaults are those of the stage"


@pytest.mark.parametrize("node", PIPELINE.order)
def test_parameter_schemas_are_json_schemas(node):
    jsonschema.Draft202012Validator.check_schema(parameter_schema(PIPELINE, node).written)


def test_wrong_parameters_are_named(cli, capture):
    for assignment, says in (
        ("usd-export.gird=2", "usd-export has no parameter gird; did you mean grid?"),
        ("joint-optimisation.steps=2", "no stage joint-optimisation"),
        ("joint-optimization.guidance=2", "it is joint-optimization.estimator.guidance (dataset-update"),
        (
            "joint-optimization.estimator.guidance=2",
            "estimator completed-views has no parameter guidance; dataset-update",
        ),
        ("joint-optimization.estimator=reference", "reference"),
        ("usd-export.grid=lots", "usd-export.grid: 'lots' is not of type 'integer'"),
        ("joint-optimization.ranks=3", "joint-optimization: rays 512 do not share out over 3 ranks"),
        ("continued-reconstruction.steps=1", "changes nothing: continued-reconstruction is left out (a control"),
        ("guidance", "write STAGE.PARAM=VALUE"),
        ("joint-optimization.seed=-1", "a seed is a whole number"),
    ):
        for command in ("run", "plan"):
            result = cli(command, str(capture), "--stub", "--set", assignment)
            assert result.returncode == 2
            assert says in result.stderr, result.stderr
    assert list(FolderStore(cli.store).objects()) == [], "nothing was taken in"


@pytest.mark.parametrize("option", ["--corpus", "--prior"])
def test_what_is_given_and_nothing_reads_is_refused(cli, capture, option):
    given = str(REPOSITORY / "priors" / "general")
    for command in ("run", "plan"):
        result = cli(command, str(capture), "--stub", option, given)
        assert result.returncode == 2
        assert f"{option} {given} changes nothing: diffusion-training, which reads it, is left out" in result.stderr
        assert "--set joint-optimization.estimator=" in result.stderr


def test_what_is_left_out_is_said_and_runs_when_it_is_asked_for(ran):
    cli, arguments = ran
    reason = (
        "nothing asks for it: view-completion's method photo-completion does not read diffusion-prior; "
        "joint-optimization's estimator completed-views does not read diffusion-prior"
    )
    folder = cli.runs / "tiny"
    stages = {s["node"]: s for s in json.loads((folder / "metrics.json").read_text())["stages"]}
    assert stages["diffusion-training"]["reason"] == reason
    assert stages["continued-reconstruction"]["reason"] == "a control; --compare runs it"
    assert reason in html.unescape((folder / "report.html").read_text())
    assert reason in cli("why", "tiny", "diffusion-training").stdout
    assert "left-out" in cli("show", "tiny").stdout
    planned = {r["node"]: r for r in json.loads(cli("plan", *arguments[1:], "--json").stdout)}
    assert (planned["diffusion-training"]["status"], planned["diffusion-training"]["reason"]) == ("left-out", reason)
    assert "diffusion-prior" not in planned["evaluation"]["components"]["inputs"]

    again = cli(*arguments, "--until", "diffusion-training")
    assert "tiny: left out: continued-reconstruction (a control; --compare runs it)" in again.stderr
    assert {n for n, s in cli.statuses().items() if s == "done"} == {"diffusion-training"}
    cli(*arguments, "--compare")
    assert {n for n, s in cli.statuses().items() if s == "done"} == {"continued-reconstruction", "evaluation"}
    cli(*arguments, "--set", "joint-optimization.estimator=sds")
    assert cli.statuses()["diffusion-training"] == "cached"
    assert cli.statuses()["joint-optimization"] == "done"


def test_a_view_that_the_capture_lacks_is_found_right_after_ingest(cli, tmp_path):
    (tmp_path / "mask.yaml").write_text("mask: {kind: object, view: IMG_1, points: [[1, 2]]}\n")
    capture = REPOSITORY / "stages" / "capture_ingest" / "tests" / "tiny_source"
    arguments = (str(capture), "--name", "tiny", "--mask", str(tmp_path / "mask.yaml"))
    result = cli("run", *arguments)
    assert result.returncode == 2
    assert f"{tmp_path / 'mask.yaml'}: mask.view: no view IMG_1; there are " in result.stderr
    states = cli.statuses()
    assert (states["capture-ingest"], states["pose-estimation"], states["mask-authoring"]) == (
        "done", "pending", "failed",
    )  # fmt: skip
    planned = cli("plan", *arguments)
    assert planned.returncode == 2
    assert "no view IMG_1" in planned.stderr
    (tmp_path / "mask.yaml").write_text("mask: {kind: object, veiw: IMG_1}\n")
    assert "mask.yaml:1" in cli("plan", *arguments).stderr


def test_missing_capture_is_bad_input(cli, tmp_path):
    result = cli("run", str(tmp_path / "nowhere"))
    assert result.returncode == 3
    assert "nowhere does not exist" in result.stderr
