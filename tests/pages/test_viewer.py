"""The viewer as a person uses it, and the film."""

import re
import subprocess
import urllib.error
import urllib.request

import cv2
import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.cameras import Camera
from inpaint3d.stages.evaluation.viewer.film import interpolate
from inpaint3d.stages.evaluation.viewer.scene import place_camera
from tests.browser import LAPTOP, PHONE, TABLET, find_violations, open_page, overflows
from tests.conftest import REPOSITORY

POSE = "1,0,0,0,0,1,0,0,0,0,1,-2"


@pytest.fixture(scope="module")
def address(cli):
    """The stage's own process, as the command starts it."""
    line = cli.command("view", "good")
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True, env=cli.environment(), cwd=REPOSITORY) as process:
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found is not None
        yield found.group()
        process.terminate()


def ask(url: str) -> tuple[int, bytes]:
    try:
        with urllib.request.urlopen(url) as answer:  # noqa: S310 - our own
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


def test_a_person_looks_around(browser, address):
    with open_page(browser, address) as page:
        shown = page.locator("#under[data-width='320']")
        shown.wait_for()  # finer by itself while the camera rests
        first = shown.get_attribute("src")
        page.locator("#stage").focus()
        page.keyboard.press("ArrowLeft")
        page.locator("#status", has_text="moved").wait_for()
        assert page.locator("#under").get_attribute("src") != first
        page.locator("#left").select_option("masked")
        page.get_by_role("button", name="Back to the camera").click()
        page.locator("#over[data-width='120']").wait_for()
        assert page.locator("#over").evaluate("e => e.naturalWidth") > 0
        page.locator("#at").fill("80")
        assert page.locator("#stage").evaluate("e => e.style.getPropertyValue('--at')") == "80%"


@pytest.mark.parametrize("size", [PHONE, TABLET, LAPTOP])
def test_nothing_stands_in_the_way_of_anybody(browser, address, size):
    with open_page(browser, address, size) as page:
        page.locator("#over[data-width]").wait_for()
        assert not overflows(page)
        assert find_violations(page) == []


@pytest.mark.parametrize(
    ("path", "status"),
    [
        (f"render/inpainted/colour/64/me/1/{POSE},0.8,0.75", 200),
        (f"render/inpainted/colour/64/me/1/{POSE},0.8", 400),
        (f"render/inpainted/colour/64000/me/1/{POSE},0.8,0.75", 400),
        (f"render/inpainted/colour/64/me/1/{POSE.replace('2', 'nan')},0.8,0.75", 400),
        (f"render/inpainted/colour/64/me/1/{POSE},0.005,0.75", 422),
        (f"render/inpainted/colour/64/me/1/{POSE},0.8,200", 422),
        (f"render/nothing/colour/64/me/1/{POSE},0.8,0.75", 422),
        ("photo/../../etc/passwd", 404),
    ],
)
def test_what_cannot_be_rendered_is_refused(address, path, status):
    code, body = ask(address + path)
    assert code == status
    assert body.startswith(b"\xff\xd8") == (status == 200)


def test_a_pose_that_is_no_rotation_is_refused():
    with pytest.raises(BadInputError, match="no rotation"):
        place_camera(np.ones(12), 1.0, 8, 6)


def test_a_path_goes_through_the_cameras():
    cameras = [Camera(80, 80, 50, 40, 100, 80, np.c_[np.eye(3), [x, 0.0, 0.0]]) for x in (0.0, 1.0, 3.0)]
    found = interpolate(cameras, 5, 50)
    assert [(c.width, c.height, c.fx) for c in found] == [(50, 40, 40.0)] * 5
    np.testing.assert_allclose([c.centre[0] for c in found[::2]], [0, 1, 3], atol=1e-12)
    with pytest.raises(BadInputError, match="two cameras"):
        interpolate(cameras[:1], 5, 50)


def test_a_film_is_as_long_as_was_asked_for(cli, tmp_path):
    file = tmp_path / "way.mp4"
    result = cli("video", "good", "--out", str(file), "--seconds", "0.5", "--rate", "12", "--width", "32")
    assert result.returncode == 0, result.stderr
    film = cv2.VideoCapture(str(file))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 6
    assert film.get(cv2.CAP_PROP_FRAME_WIDTH) == 32
    assert cli("video", "bad").returncode == 3  # it has no field
    refused = cli("video", "good", "--out", str(tmp_path / "way.gif"), "--width", "32")
    assert refused.returncode == 3
    assert "a film ends in .mp4" in refused.stderr
