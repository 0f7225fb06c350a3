"""The rule that chooses the default, on figures made up for it."""

import pytest
from benchmarks.joint.__main__ import add, read, rows_of
from benchmarks.joint.rows import (
    BASELINES,
    ESTIMATORS,
    FIGURES,
    ROWS,
    Figures,
    Measured,
    chosen,
    find_row,
    shortfalls,
    spread,
)
from benchmarks.joint.table import table

from inpaint3d.contracts.models.pipeline import Pipeline, merge_parameters
from inpaint3d.orchestrator.parameters import resolve_parameters
from tests.conftest import REPOSITORY

GOOD: Figures = {"psnr": 24.0, "ssim": 0.7, "lpips_vgg": 0.3, "gradient_share": 1.0, "opacity_mean": 0.99}
POOR: Figures = GOOD | {"ssim": 0.6, "lpips_vgg": 0.4, "gradient_share": 0.2}


def seeds(figures: Figures, **step: float) -> list[Figures]:
    return [figures | {name: figures[name] + k * by for name, by in step.items()} for k in (-1, 0, 1)]


def measured(**rows: list[Figures]) -> Measured:
    return {"demo": {name: seeds(POOR) for name in BASELINES} | {n.replace("_", "-"): r for n, r in rows.items()}}


@pytest.mark.parametrize("name", ROWS)
def test_every_row_has_valid_parameters(name):
    """What a row says is what the stages get, whatever else they fill in."""
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml")
    row = find_row(name, pipeline.parameters("joint-optimization", "paper"))
    for node, changes in (("joint-optimization", row.joint), ("view-completion", row.completion or {})):
        resolved = resolve_parameters(pipeline, node, changes)
        assert merge_parameters(resolved, changes) == resolved


def test_blur_is_not_a_fill_however_small_its_lpips():
    blurred = seeds(GOOD | {"lpips_vgg": 0.1, "gradient_share": 0.5})
    assert chosen(measured(sds=blurred, ism=seeds(GOOD))) == "ism"
    fog = seeds(GOOD | {"lpips_vgg": 0.1, "opacity_mean": 0.9})
    assert chosen(measured(sds=fog, ism=seeds(GOOD))) == "ism"
    # Where none is a fill, the least LPIPS is taken and its shortfall told.
    assert chosen(measured(sds=blurred)) == "sds"
    assert "gradient energy 0.50" in shortfalls(measured(sds=blurred), "sds")[0]


def test_a_row_that_one_scene_lacks_is_no_candidate():
    both = {"demo": measured(sds=seeds(POOR), ism=seeds(GOOD))["demo"], "statue": measured(sds=seeds(POOR))["demo"]}
    assert chosen(both) == "sds"
    assert chosen({}) is None


def test_a_gain_within_the_seeds_spread_does_not_count():
    assert shortfalls(measured(sds=seeds(GOOD)), "sds") == []
    noisy = seeds(GOOD, lpips_vgg=0.2)
    assert spread(noisy, "lpips_vgg") == pytest.approx(0.2)
    assert [s.split()[1] for s in shortfalls(measured(sds=noisy), "sds")] == ["lpips_vgg"] * len(BASELINES)
    dark = seeds(GOOD | {"psnr": POOR["psnr"] - 0.4})
    assert all("0.40 dB under" in s for s in shortfalls(measured(sds=dark), "sds"))
    few = measured(sds=seeds(GOOD))
    del few["demo"]["classical"]
    assert shortfalls(few, "sds") == ["demo: classical was not measured"]


def test_the_paper_s_rows_take_its_schedule_and_leave_the_sizes_alone():
    paper = Pipeline(REPOSITORY / "pipeline.yaml").parameters("joint-optimization", "paper")
    row = find_row("paper", paper).joint
    estimator = row["estimator"]
    assert (estimator["t_min"], estimator["schedule_steps"], estimator["guidance"]) == (0.2, 2200, 8.0)
    assert row["loss_weights"]["line_of_sight"] == 0.0
    assert not {"rays", "architecture", "depth_patch_size"} & row.keys()
    without = find_row("paper-without-depth-loss", paper).joint
    assert without == row | {"loss_weights": row["loss_weights"] | {"depth": 0.0}}
    assert find_row("paper-guidance-1", paper).joint["estimator"] == estimator | {"guidance": 1.0}
    assert set(ESTIMATORS) & set(BASELINES) == set()


def test_rows_that_fit_completed_views_say_how_these_are_made():
    paper = Pipeline(REPOSITORY / "pipeline.yaml").parameters("joint-optimization", "paper")
    fitting = {name for name in ROWS if find_row(name, paper).completion is not None}
    assert fitting == {"classical", "inpaint-then-nerf", "photo-completion"}


def test_a_scene_outside_the_rule_changes_no_choice_and_takes_the_chosen_row_alone(tmp_path):
    out = tmp_path / "joint.json"
    for scene, row, lpips in (("demo", "sds", 0.3), ("bear", "sds", 0.5), ("bear", "ism", 0.1)):
        add(out, scene, row, GOOD | {"seed": 0, "lpips_vgg": lpips}, None, quick=False)
    kept = read(out)
    assert kept["default"]["row"] == "sds"
    assert not any("bear" in shortfall for shortfall in kept["default"]["shortfalls"])
    assert kept["measured"]["bear"]["ism"][0]["lpips_vgg"] == 0.1
    assert rows_of("bear", kept) == (*BASELINES, "sds")
    assert rows_of("demo", kept) == ROWS
    with pytest.raises(SystemExit, match="there is none yet"):
        rows_of("bear", {})


def write_runs(out, row, commit, **runs):
    """A file with runs of a row: processor -> LPIPS."""
    for seed, (processor, lpips) in enumerate(runs.items()):
        run = GOOD | dict.fromkeys(FIGURES, 0.5) | {"wall_s": 1.0, "cpu_s": 1.0, "lpips_vgg": lpips, "seed": seed}
        add(out, "demo", row, run | {"processor": processor, "commit": commit}, None, quick=False)
    return read(out)


def test_a_row_of_the_table_names_the_processors_and_the_code_it_was_measured_with(tmp_path):
    (row,) = [
        line
        for line in table(write_runs(tmp_path / "joint.json", "sds", "c0ffee012", Alpha=0.2, Beta=0.2), {}).splitlines()
        if line.startswith("| sds ")
    ]
    assert row.startswith("| sds | 2 | ")
    assert row.endswith(" | Alpha, Beta | c0ffee0 |")


def test_a_table_says_what_became_of_an_earlier_one(tmp_path):
    earlier = write_runs(tmp_path / "old.json", "sds", "aaaaaaa1", Alpha=0.2, Beta=0.3)
    write_runs(tmp_path / "new.json", "no-prior", "bbbbbbb1", Alpha=0.5)
    text = table(write_runs(tmp_path / "new.json", "sds", "bbbbbbb1", Alpha=0.4), earlier)
    (row,) = [line for line in text.splitlines() if "->" in line and line.startswith("| sds ")]
    assert (
        row
        == "| sds | 2, 1 | 0.50 -> 0.50, 0.00 | 0.500 -> 0.500, 0.000 | 0.250 -> 0.400, 0.071* | aaaaaaa -> bbbbbbb |"
    )
    assert "took the object's request anew" in text
    assert "Rule:" not in text, "some rows that it is about were not measured"
