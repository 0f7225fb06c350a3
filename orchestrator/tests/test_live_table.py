"""What a terminal shows while a run goes on."""

import io

import pytest
from rich.console import Console

from inpaint3d.orchestrator import progress
from inpaint3d.orchestrator.live_table import LiveTable
from inpaint3d.orchestrator.progress import Eta


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass when the test says so."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_states_times_and_notes_stand_in_columns_of_their_own():
    screen = io.StringIO()
    table = LiveTable(["ingest", "train"], Console(file=screen, width=100, force_terminal=True, color_system=None))
    table.node("ingest", "running", "never run")
    table.node("ingest", "done", "never run", wall_s=75.4)
    table.node("train", "running", "never run")
    table.progress("train", {"done": 30, "total": 100, "message": "fit <1>"})
    table.node("train", "running", "went back to a checkpoint")
    table.node("left", "left-out", "nothing asks for it")
    table.close()
    last = screen.getvalue().split("ingest")[-1]
    assert "done" in last
    assert "1:15" in last
    assert last.index("running") < last.index("went back to a checkpoint")
    assert "left-out" in last


def test_the_time_left_is_that_of_the_part_at_hand(clock):
    eta = Eta()
    assert eta.seconds("n", 0, 50) is None
    clock[0] += 10
    assert eta.seconds("n", 25, 50) == pytest.approx(10)
    clock[0] += 1
    assert eta.seconds("n", 5, 500) is None  # another part: its pace is not known yet
    clock[0] += 10
    assert eta.seconds("n", 105, 500) == pytest.approx(39.5)
