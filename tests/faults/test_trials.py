"""Small samples of `make test-faults`."""

import pytest

from tests.faults import beside_gc, fuzz, write_sites
from tests.faults.trials import carry_out


def test_nothing_is_lost_half_there_or_wrong(tmp_path):
    counts, faults = carry_out(kills=2, corruptions=60, seed=1, folder=tmp_path)
    assert faults == []
    assert sum(counts.values()) == 62
    assert {"corrupted checkpoint", "corrupted key", "corrupted lock", "corrupted object", "corrupted record"} < set(
        counts
    )


def test_damaged_inputs_are_read_or_refused_and_nothing_else(tmp_path):
    counts, faults = fuzz.fuzz(count=900, seed=1, folder=tmp_path)
    assert faults == []
    assert len(counts) == 18
    assert all(outcomes["refused"] for outcomes in counts.values())
    assert sum(outcomes["read"] for outcomes in counts.values()) > 0


@pytest.mark.parametrize(("error", "at"), [("ENOSPC", 5), ("EMFILE", 2)])
def test_a_stage_whose_write_fails_ends_as_documented_and_goes_on(tmp_path, error, at):
    there, faults = write_sites.try_site("stage", error, at, tmp_path)
    assert there
    assert faults == []


def test_gc_takes_nothing_from_those_who_commit(tmp_path):
    counts, faults = beside_gc.carry_out(tmp_path, processes=3, results=10)
    assert faults == []
    assert counts["gc ran"] > 0
