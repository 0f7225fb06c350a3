import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.orchestrator.budget.choice import (
    Cost,
    Limits,
    choose_point,
    cut_steps,
    find_least_steps,
    learn_pace,
    list_costs,
    read_limits,
)
from inpaint3d.orchestrator.study.points import Point, StageCost

COSTS = {"pretrain": Cost(60, 20), "masks": Cost(0, 10), "join": Cost(100, 20), "export": Cost(0, 30)}
STEPS = {"pretrain": 800, "join": 400}


def point(name: str, cpu_s: float, psnr: float, mib: int = 500, **further: float) -> Point:
    stages = {
        node: StageCost(wall_s=2 * s, cpu_s=s, peak_memory_bytes=mib * 2**20, steps_cpu_s=0.75 * s)
        for node, s in {"pose-estimation": 999.0, "join": cpu_s, **further}.items()
    }
    return Point(
        name=name, state="done", preset="standard", stages=stages, figures={"psnr": psnr},
        command=f"inpaint3d run C --set join.steps={cpu_s:.0f} --set 'join.x=a b' --name {name}",
    )  # fmt: skip


POINTS = [point("quick", 50, 20.0, 300), point("middle", 200, 24.0), point("long", 500, 25.0, 900, export=40.0)]


@pytest.mark.parametrize(
    ("text", "seconds"), [("90s", 90.0), ("5m", 300.0), ("1h", 3600.0), ("2.5m", 150.0), (" 5m ", 300.0)]
)
def test_times_are_read(text, seconds):
    assert read_limits(text, None, None) == Limits(seconds=seconds)


def test_sizes_are_read():
    assert read_limits(None, "4G", 25.0) == Limits(memory_bytes=4 * 2**30, psnr=25.0)


@pytest.mark.parametrize("text", ["5", "m", "-5m", "0s", "5 minutes", "5d", ""])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(ConfigurationError, match=r"--time-budget .*write 90s, 5m or 1h"):
        read_limits(text, None, None)


def test_a_stage_that_a_point_did_not_run_costs_what_it_did_elsewhere():
    assert list_costs(POINTS[0], POINTS)["export"].seconds == 40
    assert "pose-estimation" not in list_costs(POINTS[0], POINTS)


@pytest.mark.parametrize(
    ("limits", "pace", "chosen"),
    [
        (Limits(), 1.0, "long"),
        (Limits(seconds=300), 1.0, "middle"),  # 240 s with the export, 10 % of the budget unplanned
        (Limits(seconds=300), 1.2, "quick"),
        (Limits(seconds=10), 1.0, "quick"),  # none fits: the shortest, to be cut
        (Limits(memory_bytes=400 * 2**20), 1.0, "quick"),
        (Limits(psnr=23.0), 1.0, "middle"),
        (Limits(psnr=99.0), 1.0, "long"),
        (Limits(seconds=300, psnr=19.0), 1.0, "quick"),
    ],
)
def test_the_best_point_within_the_limits_is_chosen(limits, pace, chosen):
    assert choose_point(POINTS, limits, pace).point.name == chosen


def test_too_little_memory_is_refused_with_what_would_do():
    with pytest.raises(ConfigurationError, match="give 300M or more"):
        choose_point(POINTS, Limits(memory_bytes=2**20), 1.0)


def test_steps_are_left_alone_where_the_time_is_enough():
    assert cut_steps(STEPS, COSTS, 400, 1.0, ()) == STEPS


@pytest.mark.parametrize("pace", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("seconds", [200.0, 300.0, 600.0])
def test_what_is_planned_with_the_cut_steps_fits_the_time(seconds, pace):
    cut = cut_steps(STEPS, COSTS, seconds, pace, ())
    planned = pace * sum(c.rest_s + c.steps_s * cut.get(n, 0) / STEPS.get(n, 1) for n, c in COSTS.items())
    assert planned <= seconds or set(cut.values()) == {50}


def test_stages_that_are_done_cost_nothing_more_and_have_no_steps_left():
    assert cut_steps(STEPS, COSTS, 160, 1.0, ("pretrain", "masks")) == {"join": 400}
    assert cut_steps(STEPS, COSTS, 110, 1.0, ("pretrain", "masks"))["join"] < 300


def test_no_fit_gets_fewer_than_fifty_steps():
    assert cut_steps({"join": 400, "pretrain": 30}, COSTS, 1.0, 1.0, ()) == {"join": 50, "pretrain": 30}


def test_a_fit_that_masks_are_made_of_keeps_the_fewest_steps_that_were_measured():
    steps = {"nerf-pretraining": 800, "join": 400}
    commands = [f"run C --set nerf-pretraining.steps={n}" for n in (400, 600)]
    measured = [POINTS[0].model_copy(update={"command": command}) for command in commands]
    least = find_least_steps(measured, steps)
    assert least == {"nerf-pretraining": 400, "join": 50}
    costs = {"nerf-pretraining": Cost(60, 20), "join": Cost(100, 20)}
    cut = cut_steps(steps, costs, 120, 1.0, (), least)
    assert cut["nerf-pretraining"] == 400
    assert 50 < cut["join"] < 200  # it pays for what the first fit keeps
    assert 30 + 40 + 100 * cut["join"] / 400 <= 120
    assert cut_steps(steps, costs, 1, 1.0, (), least) == least


@pytest.mark.parametrize(("spent", "pace"), [(180.0, 2.0), (45.0, 1.0), (0.0, 1.0)])
def test_the_pace_is_learnt_from_what_is_done_and_never_made_faster(spent, pace):
    assert learn_pace(1.0, COSTS, spent, ("pretrain", "masks")) == pace
    assert learn_pace(pace, COSTS, spent, ()) == pace  # nothing was planned of what took so long


def test_a_points_settings_are_those_of_its_command():
    assert POINTS[0].assignments == ["join.steps=50", "join.x=a b"]
