"""What the page is told of the synthetic room: masks at once and carried, surfaces, and what is saved."""

import json
import time
from contextlib import closing

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.kit.page_server import Refusal
from inpaint3d.contracts.models.artifacts import Capture, MaskRequest, PosedCapture, RadianceFieldArtifact, Segmenter
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.orchestrator.intake import take_segmenter
from inpaint3d.scene.synthetic import BALL_RADIUS
from inpaint3d.stages.mask_authoring.author import author
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.page.editor import Editor
from inpaint3d.stages.mask_authoring.page.masks import trace_outline
from inpaint3d.stages.mask_authoring.page.pictures import fit_size, open_subject
from inpaint3d.stages.mask_authoring.sam import load_segmenter
from inpaint3d.stages.mask_authoring.segment import iou
from tests.page.room import build_room
from tests.sam_networks import REACH, write_networks

FAST = Config(voxels=32, grabcut_rounds=2, refine_rounds=1)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    return build_room(tmp_path_factory.mktemp("store"))


def open_room(room, *, posed=True, field=True, segmenter=None):
    return open_subject(
        room.store.open(room.capture, Capture),
        room.store.open(room.posed, PosedCapture) if posed else None,
        room.store.open(room.field, RadianceFieldArtifact) if field else None,
        segmenter,
    )


def open_editor(room, folder, *, posed=True, field=True, segmenter=None):
    subject = open_room(room, posed=posed, field=field, segmenter=segmenter)
    return closing(Editor("room", subject, folder / "mask.yaml", "inpaint3d run PHOTOS", FAST))


@pytest.fixture
def editor(room, tmp_path):
    with open_editor(room, tmp_path) as opened:
        yield opened


def ask(editor, path, **question):
    return json.loads(editor.post(path, question).body)


def tell(editor):
    return json.loads(editor.get("scene").body)


def on_ball(room, view=2, **more):
    mask = {"kind": "object", "view": room.scene.names[view], "points": [room.middle_of_ball(view)], **more}
    return {"mask": mask, "dilate": 0.0}


def fill(outline, shape):
    """The mask that an outline encloses."""
    large = np.zeros((4 * shape[0], 4 * shape[1]), np.uint8)
    cv2.fillPoly(large, [(4 * np.array(o).reshape(-1, 2)).astype(np.int32) for o in outline], 1)
    return cv2.resize(large, shape[::-1], interpolation=cv2.INTER_AREA).astype(bool)


def carry(editor, request, limit_s=60.0):
    number = ask(editor, "carry", request=request)["number"]
    return number, wait(editor, limit_s)


def wait(editor, limit_s=60.0):
    until = time.monotonic() + limit_s
    while time.monotonic() < until:
        state = ask(editor, "progress", revision=0)
        if state["complete"]:
            return state
        time.sleep(0.02)
    raise TimeoutError("nothing was carried")


def test_a_click_on_the_ball_masks_it_at_once(editor, room):
    told = ask(editor, "mask", request=on_ball(room), view="view_002")
    truth = room.scene.object_masks[2]
    assert iou(fill(told["outline"], truth.shape), truth) > 0.85
    assert told["share"] == pytest.approx(truth.mean(), rel=0.15)


def test_a_network_that_was_named_is_asked_at_once_and_for_what_is_carried(room, tmp_path):
    digest = take_segmenter(room.store, *write_networks(tmp_path, "sam2"))
    network = load_segmenter(room.store.open(digest, Segmenter), threads=1)
    x, y = room.middle_of_ball(2)
    with open_editor(room, tmp_path, segmenter=network) as editor:
        assert tell(editor)["finder"] == "Segment Anything 2"
        told = ask(editor, "mask", request=on_ball(room), view="view_002")
        found = fill(told["outline"], (90, 120))
        columns, rows = np.meshgrid(np.arange(120) + 0.5, np.arange(90) + 0.5)
        box = (np.abs(columns - x) < REACH * 120) & (np.abs(rows - y) < REACH * 90)
        assert iou(found, box) > max(0.85, iou(found, room.scene.object_masks[2]) + 0.1), "its answer, not the ball"
        assert carry(editor, on_ball(room))[1]["error"] is None


def test_on_another_view_only_carrying_can_tell(editor, room):
    assert ask(editor, "mask", request=on_ball(room), view="view_001") == {"outline": None, "share": None}


def test_masks_are_carried_to_every_view(editor, room):
    number, state = carry(editor, on_ball(room))
    assert (state["number"], state["error"]) == (number, None)
    assert list(state["outlines"]) == room.scene.names
    found = [
        fill(state["outlines"][n], m.shape) for n, m in zip(room.scene.names, room.scene.object_masks, strict=True)
    ]
    assert min(map(iou, found, room.scene.object_masks)) > 0.75
    assert state["consistency"] > 0.7
    again = ask(editor, "progress", revision=state["revision"])
    assert (again["outlines"], again["complete"]) == (None, True)


def test_what_is_carried_is_what_the_stage_makes_of_the_request(editor, room, tmp_path):
    request = MaskRequest.model_validate(on_ball(room))
    subject = open_room(room)
    ctx = Context(seed=0, device="cpu", threads=1, work=tmp_path, emit=lambda event, **values: None)
    masks = author(request.mask, subject.scene, request.dilate, FAST, ctx).masks
    expected = {name: trace_outline(mask, 120, 90) for name, mask in zip(subject.names(), masks, strict=True)}
    for _ in range(2):  # what is kept of the first serves the second
        assert carry(editor, on_ball(room))[1]["outlines"] == expected


def test_the_latest_request_wins(editor, room):
    ask(editor, "carry", request=on_ball(room))
    sphere = {"mask": {"kind": "sphere", "centre": [0, 0, 0], "radius": BALL_RADIUS}}
    number, state = carry(editor, sphere)
    assert (state["number"], number) == (2, 2)
    assert iou(fill(state["outlines"]["view_000"], (90, 120)), room.scene.object_masks[0]) > 0.9


def test_what_cannot_be_carried_says_why_and_the_next_is_carried(editor, room):
    far = {"mask": {"kind": "object", "view": "view_002", "box": [0, 0, 120, 90]}}
    assert carry(editor, far)[1]["error"] is not None
    assert carry(editor, on_ball(room))[1]["error"] is None


def test_a_sphere_on_the_surface_clicked_at_is_seen_at_once_in_every_view(editor, room):
    click = {"view": "view_002", "at": room.middle_of_ball(2)}
    request = {"mask": {"kind": "sphere", "surface": click, "radius": 0.3}}
    for view, x, y in ((v, *room.middle_of_ball(v)) for v in (0, 2)):
        mask = fill(ask(editor, "mask", request=request, view=f"view_{view:03d}")["outline"], (90, 120))
        assert mask[round(y), round(x)]
        assert 0.05 < mask.mean() < 0.5


def test_strokes_together_are_seen_at_once_on_their_views(editor, room):
    stroke = {"kind": "scribble", "view": "view_002", "path": [[20, 70], [40, 70]]}
    other = {**stroke, "path": [[80, 20], [100, 20]]}
    union = {"mask": {"kind": "union", "of": [stroke, other]}}
    mask = fill(ask(editor, "mask", request=union, view="view_002")["outline"], (90, 120))
    assert mask[70, 30]
    assert mask[20, 90]
    assert ask(editor, "mask", request=union, view="view_001")["outline"] is None


def test_an_object_may_be_pointed_at_on_more_views_and_is_seen_on_each(editor, room):
    more = on_ball(room, 1)["mask"]
    del more["kind"]
    request = on_ball(room, 3, other_views=[more])
    for view in (1, 3):
        told = ask(editor, "mask", request=request, view=f"view_{view:03d}")
        assert iou(fill(told["outline"], (90, 120)), room.scene.object_masks[view]) > 0.8
    assert carry(editor, request)[1]["error"] is None


def test_several_objects_are_saved_as_one_request(editor, room, tmp_path):
    named = {"ball": on_ball(room)["mask"], "hollow": {"kind": "sphere", "centre": [0, 0, 0], "radius": 0.1}}
    ask(editor, "save", request={"mask": {"kind": "objects", "named": named}})
    assert list(load_document(tmp_path / "mask.yaml", MaskRequest)[0].mask.named) == ["ball", "hollow"]


def test_a_stroke_is_seen_at_once(editor, room):
    x, y = room.middle_of_ball(2)
    request = {"mask": {"kind": "scribble", "view": "view_002", "path": [[x - 20, y], [x + 20, y]], "thickness": 0.1}}
    mask = fill(ask(editor, "mask", request=request, view="view_002")["outline"], (90, 120))
    assert mask[int(y), int(x) - 18 : int(x) + 18].all()
    assert not mask[int(y) + 15].any()


@pytest.mark.parametrize(("posed", "says"), [(False, "Cameras"), (True, "field")])
def test_before_there_is_a_field_single_pictures_work_and_what_is_missing_is_said(room, tmp_path, posed, says):
    away = [[5, 5], [115, 5], [10, 80], [110, 80]]
    with open_editor(room, tmp_path, posed=posed, field=False) as editor:
        assert says in tell(editor)["missing"]
        told = ask(editor, "mask", request=on_ball(room, background=away), view="view_002")
        assert iou(fill(told["outline"], (90, 120)), room.scene.object_masks[2]) > 0.6
        with pytest.raises(ConfigurationError, match=says):
            ask(editor, "carry", request=on_ball(room))
        sphere = {"mask": {"kind": "sphere", "surface": {"view": "view_002", "at": [60, 45]}}}
        with pytest.raises(ConfigurationError, match="no surface"):
            ask(editor, "mask", request=sphere, view="view_002")


def test_what_is_saved_is_the_request_and_is_opened_again(editor, room, tmp_path):
    assert tell(editor)["saved"] is None
    request = on_ball(room, frame_size=[120, 90], background=[[3.5, 4]])
    assert ask(editor, "save", request=request)["then"] == "inpaint3d run PHOTOS"
    wanted = MaskRequest.model_validate(request)
    assert (tmp_path / "mask.yaml").read_text().splitlines()[1:4] == ["mask:", "  kind: object", "  view: view_002"]
    assert load_document(tmp_path / "mask.yaml", MaskRequest)[0] == wanted
    with open_editor(room, tmp_path) as again:
        assert tell(again)["saved"] == wanted.model_dump(mode="json")


def test_a_request_that_cannot_be_read_is_no_end_of_the_page(editor, tmp_path):
    (tmp_path / "mask.yaml").write_text("mask: {kind: sphere, radius: -1}\n")
    assert "mask.yaml:1" in tell(editor)["problem"]


@pytest.mark.parametrize(
    ("path", "question", "error"),
    [
        ("mask", {}, ValidationError),
        ("mask", {"request": {"mask": {"kind": "sphere", "radius": float("nan")}}, "view": "a"}, ValidationError),
        ("mask", {"request": {"mask": {"kind": "sphere"}}, "view": "../view_002"}, ValidationError),
        ("mask", {"request": {"mask": {"kind": "sphere"}}, "view": "view_009"}, Refusal),
        ("progress", {"revision": -1}, ValidationError),
        ("save", {"request": {"mask": {"kind": "sphere"}}, "file": "/etc/passwd"}, ValidationError),
        ("nothing", {}, Refusal),
        ("../save", {}, Refusal),
    ],
)  # fmt: skip
def test_questions_that_are_none_are_refused(editor, tmp_path, path, question, error):
    with pytest.raises(error):
        editor.post(path, question)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("outside", [[130, 45], [60, 90], [-1, 3]])
def test_points_outside_the_picture_are_refused_before_anything_is_saved(editor, tmp_path, outside):
    request = {"mask": {"kind": "object", "view": "view_002", "points": [outside], "frame_size": [120, 90]}}
    for path in ("save", "carry"):
        with pytest.raises((ConfigurationError, ValidationError), match="outside the picture"):
            ask(editor, path, request=request)
    assert list(tmp_path.iterdir()) == []


def test_pictures_are_jpegs_of_the_views_and_nothing_else_is_served(editor):
    for folder in ("frames", "thumbnails"):
        answer = editor.get(f"{folder}/view_002.jpg")
        assert (answer.kind, answer.body[:3]) == ("image/jpeg", b"\xff\xd8\xff")
    assert editor.get("").kind == "text/html"
    for path in (
        "frames/../../../etc/passwd", "frames/..%2f..%2fmask.yaml", "frames/view_009.jpg", "../__init__.py",
        "editor.py", "bundle/page.js", "frames/view_002.png", "page.js/",
    ):  # fmt: skip
        with pytest.raises(Refusal):
            editor.get(path)


def test_an_outline_encloses_its_mask_with_its_holes():
    mask = np.zeros((40, 60), bool)
    mask[5:35, 10:50] = True
    mask[15:25, 20:40] = False
    outline = trace_outline(mask, 240, 160)
    assert len(outline) == 2
    assert iou(fill(outline, (160, 240)), np.kron(mask, np.ones((4, 4), bool))) > 0.95
    assert trace_outline(np.zeros((4, 4), bool), 8, 8) == []


def test_pictures_are_made_smaller_and_never_larger():
    assert fit_size(4000, 3000, 1600) == (1600, 1200)
    assert fit_size(300, 4000, 1600) == (120, 1600)
    assert fit_size(48, 36, 1600) == (48, 36)
