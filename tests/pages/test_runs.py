"""The list of runs and two runs side by side, as people look at them."""

import http.client
from contextlib import contextmanager
from threading import Thread
from urllib.parse import urlsplit

import pytest

from inpaint3d.contracts.kit.page_server import PageServer, Refusal
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.pages.run_list import RunList
from tests.browser import LAPTOP, PHONE, TABLET, find_violations, open_page, overflows


@contextmanager
def serve(cli):
    with PageServer(RunList(FolderStore(cli.store), cli.runs).get) as server:
        thread = Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.url
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def address(cli):
    with serve(cli) as url:
        yield url


@pytest.fixture(scope="module")
def comparison(cli):
    page = cli.folder / "side by side.html"
    result = cli("compare", "good", "bad", "--page", str(page))
    assert result.returncode == 3  # `bad` made nothing
    return page.as_uri()


def test_runs_lead_to_their_stages_artifacts_files_and_report(browser, address):
    with open_page(browser, address) as page:
        page.get_by_role("link", name="good", exact=True).click()
        page.get_by_role("link", name="mask-set").click()
        assert page.locator("h1").inner_text().startswith("mask-set@")
        picture = page.get_by_role("link", name="masks/view_000.png", exact=True)
        ask = "async link => (await fetch(link.href)).headers.get('content-type')"
        assert picture.evaluate(ask) == "image/png"
        page.goto(address)
        page.get_by_role("link", name="Report of good").click()
        page.locator(".compare.live").wait_for()  # its script runs under the server's policy
        assert page.title() == "good · inpaint3d"


def test_a_run_that_goes_on_is_seen_to(browser, cli, address):
    history = History(FolderStore(cli.store))
    record = history.latest("good")
    gone_on = record.model_copy(update={"name": "live", "status": "running", "process": None})
    (cli.runs / "live" / "logs").mkdir(parents=True)
    history.save(gone_on)
    state = cli.runs / "live" / "progress.json"
    state.write_text('{"evaluation": {"done": 3, "total": 8, "message": "scoring"}}')
    with open_page(browser, f"{address}run/live/{record.id}") as page:
        assert page.get_by_text("3 of 8").is_visible()
        state.write_text('{"evaluation": {"done": 5, "total": 8, "message": "scoring"}}')
        page.get_by_text("5 of 8").wait_for()


@pytest.mark.parametrize(
    "path", ["nothing", "run/good/none", "run/../good", "artifact/sha256:0", "file/../../etc/passwd", "report/none"]
)
def test_what_there_is_not_is_refused(cli, path):
    pages = RunList(FolderStore(cli.store), cli.runs)
    with pytest.raises(Refusal):
        pages.get(path)


def test_nothing_can_be_sent(address):
    at = urlsplit(address)
    connection = http.client.HTTPConnection(at.hostname, at.port)
    connection.request("POST", at.path, "{}", {"Content-Type": "application/json"})
    assert connection.getresponse().status == 405
    connection.close()


@pytest.mark.parametrize(("size", "scheme"), [(PHONE, "dark"), (TABLET, "light"), (LAPTOP, "light")])
def test_nothing_stands_in_the_way_of_anybody(browser, cli, address, comparison, size, scheme):
    record = History(FolderStore(cli.store)).latest("good")
    mask_set = next(n for n in record.nodes if n.node == "mask-authoring").outputs["mask-set"]
    pages = [address, f"{address}run/good/{record.id}", f"{address}artifact/{mask_set}", comparison]
    for url in pages:
        with open_page(browser, url, size, color_scheme=scheme) as page:
            assert not overflows(page), url
            assert find_violations(page) == [], url


def test_two_runs_lie_side_by_side(browser, cli):
    page_file = cli.folder / "alike.html"
    assert cli("compare", "good", "good", "--page", str(page_file)).returncode == 0
    with open_page(browser, page_file.as_uri()) as page:
        assert page.get_by_text("Nothing: parameters, seeds and devices are the same in both.").is_visible()
        assert page.get_by_label("How much of good is shown").is_visible()
