"""Damaged captures are read or refused; `make fuzz-captures` tries more of them."""

from tests.fuzz_captures import KINDS, fuzz


def test_damaged_captures_are_read_or_refused_and_nothing_else():
    outcomes = fuzz(count=300)
    assert sum(outcomes.values()) == 300
    assert all(outcomes[name, "refused"] for name in KINDS)  # the damage is felt in each kind
    assert any(outcomes[name, "read"] for name in KINDS)
