"""A small sample of `make test-faults`."""

from tests.faults.trials import carry_out


def test_nothing_is_lost_half_there_or_wrong(tmp_path):
    counts, faults = carry_out(kills=2, corruptions=60, seed=1, folder=tmp_path)
    assert faults == []
    assert sum(counts.values()) == 62
    assert {"corrupted checkpoint", "corrupted key", "corrupted lock", "corrupted object", "corrupted record"} < set(
        counts
    )
