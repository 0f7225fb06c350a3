"""Parts of pages that are written by scripts, between marks: <!-- name --> and <!-- /name -->."""

import re


def fill_between(page: str, name: str, part: str) -> str:
    """A page's text with `part` between the marks of a name. Raises ValueError for a page without them."""
    filled, count = re.subn(
        rf"(<!-- {name} -->).*?(<!-- /{name} -->)", lambda marks: marks[1] + part + marks[2], page, flags=re.DOTALL
    )
    if count != 1:
        raise ValueError(f"the page has {count} parts between <!-- {name} --> and <!-- /{name} -->, not one")
    return filled
