"""The page as a person uses it, in headless Chromium: by the pointer, by the keyboard alone, on a tablet."""

import base64
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml
from playwright.sync_api import Page, expect

from inpaint3d.contracts.kit.upstream import invoke
from inpaint3d.contracts.models.artifacts import MaskRequest, MaskRequestArtifact, MaskSet
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.scene.image_io import read_mask, write_png
from tests.browser import LAPTOP, PATIENCE_MS, TABLET, find_violations, launch, open_page, overflows
from tests.conftest import REPOSITORY
from tests.page.room import Room, build_room


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Room:
    return build_room(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def browser():
    with launch() as launched:
        yield launched


@contextmanager
def serve(room: Room, saved: Path, *, field: bool = True, painted: Path | None = None) -> Iterator[str]:
    """The stage's own process; its address."""
    line = [sys.executable, "-m", "inpaint3d.stages.mask_authoring", "edit", "--store", str(room.store.place)]
    line += ["--capture", room.capture, "--save", str(saved), "--title", "room", "--then", "inpaint3d run room"]
    line += ["--posed-capture", room.posed, "--radiance-field", room.field] if field else []
    line += ["--painted", str(painted)] if painted else []
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            found = re.search(r"http://\S+", process.stdout.readline())
            assert found is not None
            yield found.group()
        finally:
            process.terminate()
            assert process.wait(20) == 143


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> Path:
    """Where the page of the whole room saves."""
    return tmp_path_factory.mktemp("runs") / "mask.yaml"


@pytest.fixture(scope="module")
def address(room, saved) -> Iterator[str]:
    with serve(room, saved) as url:
        yield url


@pytest.fixture
def person(browser, room, address, saved) -> Iterator["Person"]:
    """At a page that begins with nothing."""
    saved.unlink(missing_ok=True)
    with meet(browser, room, address, saved) as somebody:
        yield somebody


@dataclass(frozen=True)
class Person:
    """Somebody at the page; pixels are those of the room's pictures."""

    page: Page
    room: Room
    saved: Path

    def on_screen(self, x: float, y: float) -> tuple[float, float]:
        box = self.page.locator(".picture image").bounding_box()
        height, width = self.room.scene.images.shape[1:3]
        return box["x"] + x / width * box["width"], box["y"] + y / height * box["height"]

    def click(self, x: float, y: float) -> None:
        self.page.mouse.click(*self.on_screen(x, y))

    def drag(self, *path: tuple[float, float]) -> None:
        self.page.mouse.move(*self.on_screen(*path[0]))
        self.page.mouse.down()
        for at in path[1:]:
            self.page.mouse.move(*self.on_screen(*at))
        self.page.mouse.up()

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)

    def share(self) -> float:
        """Of the picture, what the masks that are drawn on it cover, by the browser's own account."""
        script = """() => {
            const svg = document.querySelector('.picture svg'), {width, height} = svg.viewBox.baseVal;
            const canvas = new OffscreenCanvas(width, height), context = canvas.getContext('2d');
            for (const path of svg.querySelectorAll('.mask'))
                context.fill(new Path2D(path.getAttribute('d')), 'evenodd');
            const {data} = context.getImageData(0, 0, width, height);
            return data.filter((value, index) => index % 4 === 3 && value > 127).length / (width * height);
        }"""
        return self.page.evaluate(script)

    def wait_until_carried(self) -> None:
        expect(self.page.locator("#status")).to_contain_text("carried to all views", timeout=PATIENCE_MS)

    def save(self) -> MaskRequest:
        self.page.get_by_role("button", name="Save").click()
        expect(self.page.locator("#then")).to_have_text("inpaint3d run room")
        self.press("Escape")
        return load_document(self.saved, MaskRequest)[0]


@contextmanager
def meet(browser, room: Room, url: str, saved: Path) -> Iterator[Person]:
    """A person at a page."""
    with open_page(browser, url) as page:
        expect(page.locator("#strip button")).to_have_count(len(room.scene.names))
        yield Person(page, room, saved)


def test_a_click_masks_the_ball_everywhere_and_the_next_stage_takes_what_was_saved(person, room):
    expect(person.page.get_by_text("Painted views")).to_be_hidden()  # there is no folder of them
    person.press("PageDown", "PageDown")
    expect(person.page.locator("#name")).to_have_text("view_002 (3 of 5)")
    expect(person.page.locator("#finder")).to_have_text("GrabCut")
    assert person.share() == 0
    person.click(*room.middle_of_ball(2))
    expect(person.page.locator(".picture .mask")).to_have_attribute("d", re.compile("M.*Z"), timeout=PATIENCE_MS)
    person.wait_until_carried()
    truth = float(room.scene.object_masks[2].mean())
    assert truth < person.share() < 1.6 * truth  # masks are grown a little
    assert person.page.locator("#strip .mask:not([d=''])").count() == 5
    asked = person.save()
    assert asked.mask.kind == "object"
    assert asked.mask.view == "view_002"
    result = author(room, asked)
    for view, mask in zip(result.metadata.views, room.scene.object_masks, strict=True):
        found = read_mask(result.path(view.mask))
        assert (found & mask).sum() / mask.sum() > 0.9
        assert (found & mask).sum() / found.sum() > 0.6


def author(room: Room, request: MaskRequest):
    """What the stage makes of a request, as the pipeline runs it."""
    artifact = MaskRequestArtifact(request=request)
    digest = room.store.put(room.store.private_folder(), "mask-request", artifact)
    inputs = {"posed-capture": room.posed, "radiance-field": room.field, "mask-request": digest}
    spec = load_stage(REPOSITORY / "stages/mask_authoring/stage.yaml")
    tiny = yaml.safe_load((REPOSITORY / "stages/mask_authoring/tests/tiny.yaml").read_text())
    result = invoke(spec, room.store, inputs, parameters={**tiny, "segment_size": 120})
    assert result.code == 0, result.error + result.stderr
    return room.store.open(result.outputs["mask-set"], MaskSet)


def test_points_are_added_left_out_taken_away_undone_and_done_again(person, room):
    x, y = room.middle_of_ball(0)
    points = person.page.locator(".picture .point")
    person.click(x, y)
    person.press("l")
    person.click(x - 40, y)
    expect(points).to_have_count(2)
    expect(person.page.locator(".picture .point.away")).to_have_count(1)
    person.press("Control+z")
    expect(points).to_have_count(1)
    person.press("Control+Shift+z")
    expect(points).to_have_count(2)
    person.click(x - 40, y)  # on it: it goes
    expect(person.page.locator(".picture .point.away")).to_have_count(0)
    person.press("Control+z")
    saved = person.save()
    assert [round(v) for v in saved.mask.background[0]] == [round(x - 40), round(y)]
    assert saved.mask.frame_size == (120, 90)


def test_a_box_a_stroke_and_a_sphere_are_objects_of_their_own(person, room):
    x, y = room.middle_of_ball(0)
    person.press("b")
    person.drag((x - 22, y - 22), (x, y), (x + 22, y + 22))
    expect(person.page.locator(".picture rect.box")).to_have_count(1)
    person.press("p")
    person.drag((20, 70), (30, 72), (40, 70))
    expect(person.page.locator("#objects li")).to_have_count(2)
    person.press("s")
    person.click(x, y)
    expect(person.page.locator("#objects li")).to_have_count(3)
    expect(person.page.locator("#objects li")).to_contain_text(["box", "1 stroke", "sphere"])
    radius = person.page.get_by_label("Radius")
    before = float(radius.input_value())
    person.press("]")
    expect(radius).not_to_have_value(str(before))
    assert float(radius.input_value()) > before
    person.press("Delete")
    expect(person.page.locator("#objects li")).to_have_count(2)


def test_all_of_it_is_done_by_the_keyboard(person, room):
    person.page.locator(".picture svg").focus()
    person.press("ArrowRight", "ArrowUp", "Enter")
    expect(person.page.locator(".picture .point")).to_have_count(1)
    person.press("b", "Shift+ArrowLeft", "Shift+ArrowUp", "Enter")
    person.press(*["Shift+ArrowRight", "Shift+ArrowDown"] * 4, "Enter")
    expect(person.page.locator(".picture rect.box")).to_have_count(1)
    for _ in range(40):  # nothing but Tab leads to the button
        person.press("Tab")
        if person.page.evaluate("document.activeElement.id") == "help":
            break
    person.press("Enter")
    expect(person.page.get_by_role("dialog", name="How to point at things")).to_be_visible()
    person.press("Escape", "?")
    person.page.get_by_label("Single letters are shortcuts").uncheck()
    person.press("Escape", "n")
    expect(person.page.locator("#objects li")).to_have_count(1)


def test_before_there_is_a_field_pictures_are_pointed_at_and_what_is_missing_is_said(browser, room, tmp_path):
    x, y = room.middle_of_ball(0)
    target = tmp_path / "mask.yaml"
    with serve(room, target, field=False) as url, meet(browser, room, url, target) as person:
        expect(person.page.locator("#missing")).to_contain_text("Cameras are not known yet")
        expect(person.page.get_by_role("button", name="Sphere")).to_be_disabled()
        person.click(x, y)
        person.press("l")
        for away in ((5, 5), (115, 5), (10, 80), (110, 80)):
            person.click(*away)
        expect(person.page.locator(".picture .mask")).to_have_attribute("d", re.compile("M.*Z"), timeout=PATIENCE_MS)
        assert person.share() > 0.01
        assert len(person.save().mask.background) == 4


DROP = """async ([name, text]) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0)), files = new DataTransfer();
    files.items.add(new File([bytes], name, {type: 'image/png'}));
    document.querySelector('#painting').dispatchEvent(new DragEvent('drop', {dataTransfer: files, bubbles: true}));
}"""


def test_painted_views_are_dropped_chosen_and_taken_back_and_the_run_is_told_of_them(browser, room, tmp_path):
    folder, target = tmp_path / "painted", tmp_path / "mask.yaml"
    for part in ("asked", "masks"):
        write_png(folder / part / "view_001.png", np.full((6, 8, 3), 0.2))
    write_png(tmp_path / "view_001.png", np.full((6, 8, 3), 0.7))
    dropped = base64.b64encode((tmp_path / "view_001.png").read_bytes()).decode()
    with serve(room, target, painted=folder) as url, meet(browser, room, url, target) as person:
        zone = person.page.locator("#painting")
        expect(zone).to_contain_text("view_001: not painted")
        assert find_violations(person.page) == []
        with person.page.expect_download() as given_out:
            zone.get_by_role("link", name="Mask of view_001").click()
        assert given_out.value.path().read_bytes() == (folder / "masks/view_001.png").read_bytes()
        person.page.evaluate(DROP, ["view_001.png", dropped])
        expect(person.page.locator("#then")).to_have_text(f"inpaint3d run room --painted {folder}")
        person.press("Escape")
        expect(zone).to_contain_text("view_001: painted")
        assert (folder / "view_001.png").read_bytes() == (tmp_path / "view_001.png").read_bytes()
        zone.get_by_role("button", name="Remove view_001").click()
        expect(zone).to_contain_text("view_001: not painted")
        person.page.locator("#paintings").set_input_files(tmp_path / "view_001.png")
        expect(person.page.get_by_role("dialog", name="Saved")).to_be_visible()
        person.press("Escape")
    assert [path.name for path in folder.glob("*.png")] == ["view_001.png"]


@pytest.mark.parametrize(("size", "scheme"), [(LAPTOP, "light"), (LAPTOP, "dark"), (TABLET, "light")])
def test_nothing_stands_in_the_way_of_anybody(person, room, size, scheme):
    person.page.set_viewport_size(size)
    person.page.emulate_media(color_scheme=scheme)
    person.click(*room.middle_of_ball(0))
    person.wait_until_carried()
    assert not overflows(person.page)
    for opened in ("", "?"):
        person.press(*opened)
        assert find_violations(person.page) == []
