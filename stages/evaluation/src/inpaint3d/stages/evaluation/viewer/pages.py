"""The viewer's paths: its page, what there is, renders of any camera, photos."""

import math
from dataclasses import dataclass
from http import HTTPStatus
from importlib.resources import files
from urllib.parse import unquote

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.page_server import Answer, Refusal, answer_json
from inpaint3d.stages.evaluation.viewer.scene import Outrun, ViewerScene, place_camera

KINDS = {"viewer.html": "text/html; charset=utf-8", "viewer.js": "text/javascript", "viewer.css": "text/css"}
PACKAGE = "inpaint3d.stages.evaluation.viewer"
SIDES = (16, 1280)  # pixels of a render's width that may be asked for
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
NUMBERS = 14
"""Of a camera in a path: its pose, focal length over width, height over width."""


@dataclass(frozen=True)
class ViewerPages:
    """The page and its files, scene.json, photo/NAME, masked/NAME, render/FIELD/MAP/WIDTH/SESSION/ORDER/N,N,..."""

    scene: ViewerScene

    def get(self, path: str) -> Answer:
        """The answer to a path; Refusal for what there is not."""
        kind, _, rest = unquote(path).partition("/")
        file = kind or "viewer.html"
        if file in KINDS and not rest:
            return Answer((files(PACKAGE) / file).read_bytes(), KINDS[file], policy=POLICY)
        if kind == "scene.json" and not rest:
            return answer_json(self.scene.describe())
        if kind in ("photo", "masked") and rest in self.scene.views:
            return Answer(self.scene.photo(rest, outlined=kind == "masked"), "image/jpeg")
        if kind == "render":
            return self._render(rest)
        raise Refusal(HTTPStatus.NOT_FOUND, f"there is no {path}")

    def _render(self, rest: str) -> Answer:
        name, kind, width, session, order, numbers = self._parse(rest)
        *pose, focal, aspect = numbers
        height = min(SIDES[1], max(1, round(width * aspect)))
        try:
            camera = place_camera(pose, focal, width, height)
            return Answer(self.scene.render(name, kind, camera, session, order), "image/jpeg")
        except Outrun:
            return Answer(b"", "image/jpeg", HTTPStatus.NO_CONTENT)

    def _parse(self, rest: str) -> tuple[str, str, int, str, int, list[float]]:
        try:
            name, kind, width, session, order, numbers = rest.split("/")
            values = [float(n) for n in numbers.split(",")]
            side, turn = int(width), int(order)
        except ValueError as error:
            raise Refusal(HTTPStatus.BAD_REQUEST, "a render has field, map, width, session, order, camera") from error
        if len(values) != NUMBERS or not all(map(math.isfinite, values)) or not SIDES[0] <= side <= SIDES[1]:
            raise Refusal(HTTPStatus.BAD_REQUEST, f"a camera is {NUMBERS} numbers, a width {SIDES[0]} to {SIDES[1]}")
        if min(values[-2:]) <= 0.01 or max(values[-2:]) > 100:
            raise BadInputError("focal length and height are 0.01 to 100 widths")
        return name, kind, side, session, turn, values
