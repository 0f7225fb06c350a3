import json

import pytest

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.parameters import combine_parameters, parse_overrides
from inpaint3d.orchestrator.plan import find_pipeline
from inpaint3d.orchestrator.study import sweep as sweeping
from inpaint3d.orchestrator.study.plots import tabulate, write_pages
from inpaint3d.orchestrator.study.points import Point, StageCost, StudyResults, find_front, is_beaten, read_results
from inpaint3d.orchestrator.study.space import Knob, list_assignments, load_study

STUDY = find_pipeline(None).with_name("study.yaml")


def point(name: str, cpu_s: float, psnr: float | None, **changes) -> Point:
    cost = StageCost(wall_s=2 * cpu_s, cpu_s=cpu_s, peak_memory_bytes=2**28, held_out_psnr=psnr)
    before = StageCost(wall_s=99, cpu_s=99, peak_memory_bytes=2**20)
    values = {
        "state": "done", "preset": "standard", "knobs": {"steps": 1}, "command": f"inpaint3d run C --name {name}",
        "stages": {"pose-estimation": before, "join": cost, "evaluation": before},
        "figures": {} if psnr is None else {"psnr": psnr, "lpips_vgg": 0.3},
    } | changes  # fmt: skip
    return Point(name=name, **values)


def test_the_front_is_what_nothing_beats():
    points = [
        point("a", 10, 20.0),
        point("b", 20, 19.0),
        point("c", 30, 25.0),
        point("d", 30, 24.0),
        point("e", 40, 25.0),
    ]
    assert [p.name for p in find_front(points, Point.sum_seconds, lambda p: p.figures["psnr"])] == ["a", "c"]


def test_the_clock_begins_after_the_cameras_and_leaves_out_the_evaluation():
    assert (point("a", 10, 20.0).sum_seconds(), point("a", 10, 20.0).sum_seconds("wall_s")) == (10, 20)


@pytest.mark.parametrize(
    ("cpu_s", "psnr", "beaten"), [(20, 23.0, True), (20, 24.8, False), (5, 20.0, False), (9, None, False)]
)
def test_a_point_ends_early_where_another_was_faster_and_clearly_better(cpu_s, psnr, beaten):
    assert is_beaten(point("x", cpu_s, psnr), [point("a", 10, 25.0)], "join", 0.5) is beaten


def test_points_without_a_figure_neither_end_others_nor_are_ended():
    assert not is_beaten(point("x", 20, None), [point("a", 10, 25.0)], "join", 0.5)
    assert not is_beaten(point("x", 20, 25.0), [point("a", 10, 25.0)], "mask-authoring", 0.5)
    assert not is_beaten(point("x", 20, 24.0), [point("a", 10, None)], "join", 0.5)


def test_points_of_other_frames_do_not_end_each_other():
    """Held-out pixels of smaller frames are other pixels, and score higher."""
    small = point("a", 10, 28.0, command="inpaint3d run C --set pose-estimation.output_longest_side=320")
    assert not is_beaten(point("x", 20, 24.0), [small], "join", 0.5)


def test_every_knob_of_the_study_is_a_parameter_at_both_ends():
    spec = load_study(STUDY)
    pipeline = Pipeline(find_pipeline(None)).under(spec.preset)
    for end in (0, -1):
        drawn = {n: k.choices[end] if k.choices else (k.low, k.high)[end] for n, k in spec.knobs.items()}
        assignments = list_assignments(spec, drawn)
        overrides = parse_overrides(pipeline, assignments)
        for node in overrides:
            combine_parameters(pipeline, node, spec.preset, overrides)  # refuses what the stage does not know
        assert len(assignments) == sum(len(k.sets) for k in spec.knobs.values()) + sum(map(len, spec.fixed.values()))


@pytest.mark.parametrize(
    "extent", [{}, {"choices": (1,)}, {"low": 5, "high": 5}, {"choices": (1, 2), "low": 1, "high": 2}]
)
def test_a_knob_without_extent_is_refused(extent):
    with pytest.raises(ValueError, match="two choices or more"):
        Knob(sets=("a.b",), **extent)


def test_a_study_with_a_typo_is_refused_with_its_line(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text(STUDY.read_text().replace("judge:", "juge:"))
    with pytest.raises(ConfigurationError, match=r"study\.yaml:\d+: spec\.juge"):
        load_study(path)


def draw(tmp_path, count):
    """Numbers and knobs of the trials that a call would measure, each told as done."""
    spec, found = load_study(STUDY), []
    design = sweeping.open_design(tmp_path / "journal.log", seed=0)
    for trial in sweeping._draw(design, spec, count):
        found.append((trial.number, sweeping._read_trial(spec, trial)))
        design.tell(trial.number, [1.0, 20.0])
    return found


def test_the_design_goes_on_where_it_ended_and_fills_the_space(tmp_path):
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    whole = draw(tmp_path / "one", 9)
    first, second = draw(tmp_path / "two", 4), draw(tmp_path / "two", 9)
    assert first + second == whole
    assert draw(tmp_path / "two", 9) == []
    steps = [knobs["reconstruction-steps"] for _, knobs in whole]
    assert min(steps) < 400 < 700 < max(steps)
    assert {knobs["sampler"] for _, knobs in whole} == {"density-grid", "proposal"}


def test_a_point_that_was_cut_short_is_tried_again(tmp_path):
    spec = load_study(STUDY)
    design = sweeping.open_design(tmp_path / "journal.log", seed=0)
    cut = sweeping._read_trial(spec, next(sweeping._draw(design, spec, 3)))
    again = sweeping.open_design(tmp_path / "journal.log", seed=0)
    assert sweeping._read_trial(spec, next(sweeping._draw(again, spec, 3))) == cut


def test_a_point_that_failed_is_tried_again_by_the_next_call_and_not_by_the_same(tmp_path):
    spec = load_study(STUDY)
    design = sweeping.open_design(tmp_path / "journal.log", seed=0)
    asked = []
    for trial in sweeping._draw(design, spec, 2):
        asked.append(sweeping._read_trial(spec, trial))
        sweeping._tell(design, trial.number, point("x", 1, None, state="failed"))
    assert len(asked) == 2
    assert [knobs for _, knobs in draw(tmp_path, 2)] == asked


def test_results_are_read_again_and_a_point_measured_anew_replaces_itself(tmp_path):
    results = StudyResults(capture="c", protocol="bbox10-vgg").with_point(point("a", 10, 20.0))
    slow = point("b", 5, None, state="stopped-early", knobs={"steps": 2})
    results = results.with_point(point("again", 11, 21.0)).with_point(slow)
    results.write(tmp_path / "points.json")
    assert read_results(tmp_path / "points.json") == results
    assert [p.name for p in results.measured] == ["again"]
    (tmp_path / "points.json").write_text(json.dumps({"capture": 1}))
    with pytest.raises(BadInputError, match=r"points\.json holds no results"):
        read_results(tmp_path / "points.json")


def test_the_pages_show_the_front_and_the_commands(tmp_path):
    results = StudyResults(capture="c", protocol="bbox10-vgg")
    for p in (point("a", 10, 20.0), point("b", 20, 19.0, knobs={"steps": 2}), point("draft", 5, 18.0, knobs={})):
        results = results.with_point(p)
    write_pages(results, tmp_path)
    drawn = (tmp_path / "psnr-time.svg").read_text()
    assert "bbox10-vgg" in drawn
    assert ">draft<" in drawn
    table = tabulate(results)
    assert "| a | yes | 10 | 20 | 256 | 20.00 | – | 0.300 | steps 1 |" in table
    assert table.index("run C --name draft") < table.index("run C --name a")
    assert "--name b" not in table
