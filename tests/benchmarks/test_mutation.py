"""The list of guards that are to be taken out names sources and tests that there are."""

from benchmarks.mutation import RELATED, ROOT, find_mutants


def test_the_list_of_guards_is_up_to_date() -> None:
    mutants = find_mutants()  # ValueError where one by hand is no longer in its file
    assert len(mutants) >= 60
    assert {mutant.file for mutant in mutants} <= set(RELATED)
    assert [
        path for path in {*RELATED, *(t for tests in RELATED.values() for t in tests)} if not (ROOT / path).exists()
    ] == []


def test_every_mutant_changes_its_file() -> None:
    for mutant in find_mutants():
        assert (ROOT / mutant.file).read_text()[mutant.offset :].startswith(mutant.before), mutant
        assert mutant.before != mutant.after, mutant
