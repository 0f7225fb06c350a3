"""The page of what was tried says what was measured."""

from tests.faults.write_docs import PAGE, fill_page


def test_the_page_is_up_to_date() -> None:
    text = PAGE.read_text()
    assert all(f"<!-- {name} -->" in text for name in ("kills", "trials", "overhead", "peers"))
    assert fill_page(text) == text, "run `python -m tests.faults.write_docs`"
