"""The report as people open it: wide and narrow, light and dark, on paper, after a failure."""

import html
import re

import pytest

from tests.browser import LAPTOP, PHONE, TABLET, find_violations, open_page, overflows

A4 = {"width": 703, "height": 1000}  # 210 mm less the margins, at 96 pixels an inch


@pytest.fixture(scope="module")
def address(cli):
    return {name: (cli.runs / name / "report.html").as_uri() for name in ("good", "bad")}


def test_a_report_stands_alone(cli):
    page = (cli.runs / "good" / "report.html").read_text()
    assert "<title>good · inpaint3d</title>" in page
    beside = "logs|scene|metrics|pictures|plates|splats"
    assert not re.findall(rf'(?:src|href)="(?!data:image/png|data:,|#|{beside})[^"]*"', page)
    assert "--mask" in html.unescape(page)  # the command that makes it again
    assert len(page) < 10 * 2**20


def test_a_failure_leaves_nothing_of_the_run_before_it(cli):
    page = html.unescape((cli.runs / "bad" / "report.html").read_text())
    assert "The run failed at capture-ingest:" in page
    assert "exit 3" in page
    assert not {"scene.usdz", "pictures"} & {p.name for p in (cli.runs / "bad").iterdir()}


@pytest.mark.parametrize("name", ["good", "bad"])
@pytest.mark.parametrize(("size", "scheme"), [(PHONE, "dark"), (TABLET, "light"), (LAPTOP, "light"), (LAPTOP, "dark")])
def test_nothing_stands_in_the_way_of_anybody(browser, address, name, size, scheme):
    with open_page(browser, address[name], size, color_scheme=scheme, reduced_motion="reduce") as page:
        assert not overflows(page)
        assert find_violations(page) == []


def test_the_slider_uncovers_the_photo_by_the_keyboard_too(browser, address):
    with open_page(browser, address["good"]) as page:
        slider = page.get_by_label("How much of the photo is shown")
        slider.focus()
        page.keyboard.press("End")
        assert page.locator(".compare").evaluate("e => e.style.getPropertyValue('--at')") == "100%"
        page.keyboard.press("Home")
        clip = page.locator(".compare .both > :first-child svg").evaluate("e => getComputedStyle(e).clipPath")
        assert "100%" in clip


def test_the_scene_turns_until_it_is_paused(browser, address):
    with open_page(browser, address["good"]) as page:
        shown = page.locator(".orbit .late")
        first = shown.get_attribute("src")
        page.wait_for_function("src => document.querySelector('.orbit .late').src !== src", arg=first)
        page.get_by_role("button", name="Pause").click()
        paused = shown.get_attribute("src")
        page.wait_for_timeout(400)
        assert shown.get_attribute("src") == paused
    with open_page(browser, address["good"], reduced_motion="reduce") as page:
        assert page.get_by_role("button", name="Play").is_visible()


def test_no_column_is_cut_on_paper(browser, address):
    with open_page(browser, address["good"], A4) as page:
        page.emulate_media(media="print")
        widths = page.evaluate(
            "[...document.querySelectorAll('table, svg, img, pre')].map(e => e.getBoundingClientRect().right)"
        )
        assert len(widths) > 5
        assert max(widths) <= A4["width"] + 1
        assert page.locator(".compare .both > *").nth(1).bounding_box()["x"] > 300  # before and after, side by side
