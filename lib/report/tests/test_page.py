import sys

import pytest
from jinja2 import UndefinedError

from inpaint3d.report.page import render


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with a page of its own; its name."""
    folder = tmp_path / "a_package_with_a_page"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "part.html.j2").write_text("<b>{{ name }}</b>")
    (folder / "page_of_mine.html.j2").write_text(
        '{% extends "page.html.j2" %}{% from "parts.html.j2" import table %}{% block title %}{{ name }}{% endblock %}'
        "{% block main %}{{ part }}"
        '{% call table(["a", ("b", "note")], text=["b"]) %}<tr></tr>{% endcall %}{% endblock %}'
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder.name
    sys.modules.pop(folder.name, None)


def test_values_are_escaped_and_parts_are_taken_as_they_are(package):
    part = render(package, "part.html.j2", name="<i>")
    assert part == "<b>&lt;i&gt;</b>"
    page = render(package, "page_of_mine.html.j2", name="x & y", part=part)
    assert "<title>x &amp; y</title>" in page
    assert "<b>&lt;i&gt;</b>" in page


def test_a_page_has_the_common_frame_and_tables(package):
    page = render(package, "page_of_mine.html.j2", name="n", part="")
    assert page.startswith("<!doctype html>")
    assert "<style>" in page
    assert '<th scope="col">a</th>' in page
    assert '<th scope="col" class="text">b<small>note</small></th>' in page


def test_a_value_that_a_template_lacks_is_an_error(package):
    with pytest.raises(UndefinedError, match="name"):
        render(package, "part.html.j2")
