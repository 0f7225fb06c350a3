"""Headless Chromium, for the tests of pages, and the rules of accessibility that every page is held to."""

from collections.abc import Iterator
from contextlib import contextmanager
from shutil import which
from typing import Any

import pytest

from tests.conftest import REPOSITORY

AXE = REPOSITORY / "stages/mask_authoring/page/node_modules/axe-core/axe.min.js"
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
PHONE, TABLET, LAPTOP = {"width": 390, "height": 844}, {"width": 820, "height": 1180}, {"width": 1280, "height": 800}
PATIENCE_MS = 60_000  # a machine that does other work


@contextmanager
def launch() -> Iterator[Any]:
    """A browser; the test is skipped where there is none."""
    from playwright.sync_api import sync_playwright

    if (chromium := which("chromium") or which("chromium-browser")) is None:
        pytest.skip("there is no chromium here (`make browser`)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@contextmanager
def open_page(browser: Any, url: str, size: dict[str, int] = LAPTOP, **context: Any) -> Iterator[Any]:
    """A page of its own; what the browser complains of is an error."""
    complaints: list[str] = []
    opened = browser.new_context(viewport=size, **context)
    page = opened.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(url)
    yield page
    opened.close()
    assert complaints == []


def find_violations(page: Any) -> list[tuple[str, list[str]]]:
    """What axe finds: (rule, elements). Skips where npm's packages are not there."""
    if not AXE.is_file():
        pytest.skip("npm's packages are not here (`make browser`)")
    page.evaluate(AXE.read_text())
    found = page.evaluate("rules => axe.run(document, {runOnly: rules})", RULES)
    return [(v["id"], [n["html"] for n in v["nodes"]]) for v in found["violations"]]


def overflows(page: Any) -> bool:
    """Whether a person has to scroll sideways."""
    return page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth")
