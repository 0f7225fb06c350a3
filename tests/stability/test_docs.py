"""The page of the catalogue is what the catalogue says."""

from tests.stability.write_docs import PAGE, fill_page, list_cases


def test_the_page_is_up_to_date() -> None:
    text = PAGE.read_text()
    assert "<!-- cases -->" in text
    assert "<!-- faults -->" in text
    assert fill_page(text) == text, "run `python -m tests.stability.write_docs`"


def test_the_catalogue_is_as_large_as_it_says() -> None:
    cases = list(list_cases())
    assert sum(count for _, _, count in cases) >= 120
    assert all(row.plain and row.ours and row.swept for _, row, _ in cases)
