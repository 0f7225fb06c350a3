"""What the page asks and is told: pictures, the mask on a view, masks carried to the others, and saving."""

import mimetypes
import shlex
import threading
from collections.abc import Callable
from dataclasses import asdict
from functools import cache, lru_cache
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import unquote

from pydantic import Field

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.page_server import Answer, Refusal, answer_json
from inpaint3d.contracts.models.artifacts import MaskRequest
from inpaint3d.contracts.models.base import Closed, FrameName
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.page.carrying import Carrier
from inpaint3d.stages.mask_authoring.page.masks import check_request, mask_at_once, trace_outline
from inpaint3d.stages.mask_authoring.page.painted import PaintedFolder
from inpaint3d.stages.mask_authoring.page.pictures import PICTURE_SIDE, THUMBNAIL_SIDE, Subject
from inpaint3d.stages.mask_authoring.page.saving import read_request, write_request

GRABCUT = "GrabCut"  # what finds objects where no network was named
PACKAGE = "inpaint3d.stages.mask_authoring.page"
BUNDLE = ("index.html", "page.js", "page.css", "icon.svg")
KEPT_PICTURES = 64
SIDES = {"frames": PICTURE_SIDE, "thumbnails": THUMBNAIL_SIDE}


class MaskQuestion(Closed):
    """The mask that a request gives on a view."""

    request: MaskRequest
    view: FrameName


class CarryQuestion(Closed):
    """A request to carry to all views from now on."""

    request: MaskRequest


class ProgressQuestion(Closed):
    """How far carrying is; outlines are sent where there are others than those of `revision`."""

    revision: Annotated[int, Field(ge=0)]


class SaveQuestion(Closed):
    request: MaskRequest


class ForgetQuestion(Closed):
    """What was painted in a view is no longer to count."""

    view: FrameName


class Editor:
    """The page of one capture. `saved`: the file for requests; `then`: the command that goes on with it."""

    def __init__(
        self,
        title: str,
        subject: Subject,
        saved: Path,
        then: str,
        config: Config,
        seed: int = 0,
        painted: PaintedFolder | None = None,
    ) -> None:
        self._title, self._subject, self._saved, self._command = title, subject, saved, then
        self._config, self._seed, self._painted = config, seed, painted
        self._one_at_a_time = threading.Lock()
        self._encode = lru_cache(maxsize=KEPT_PICTURES)(subject.picture)
        self._carrier = Carrier(subject, config, seed)
        self._carrier.start()
        self._methods: dict[str, tuple[type[Closed], Callable[[Any], dict[str, Any]]]] = {
            "mask": (MaskQuestion, self._mask),
            "carry": (CarryQuestion, self._carry),
            "progress": (ProgressQuestion, self._progress),
            "save": (SaveQuestion, self._save),
        }
        if painted is not None:
            self._methods["forget"] = (ForgetQuestion, self._forget)

    def close(self) -> None:
        """End what is at work in the background."""
        self._carrier.close()

    def get(self, path: str) -> Answer:
        """A file of the bundle, a view's picture, or what the page begins with."""
        if path == "scene":
            return answer_json(self._describe())
        folder, _, name = path.partition("/")
        if folder in SIDES and name.endswith(".jpg"):
            return Answer(self._picture(name.removesuffix(".jpg"), SIDES[folder]), "image/jpeg")
        if folder == "painted" and self._painted is not None and name.endswith(".png"):
            part, _, view = name.removesuffix(".png").partition("/")
            return Answer(self._painted.read(part, view), "image/png")
        if (file := path or BUNDLE[0]) in BUNDLE:
            return Answer(_read_bundle(file), mimetypes.guess_type(file)[0] or "text/plain")
        raise Refusal(HTTPStatus.NOT_FOUND, "there is no such thing here")

    def post(self, path: str, value: Any) -> Answer:
        """Answer a question; ValidationError where it is none."""
        if path not in self._methods:
            raise Refusal(HTTPStatus.NOT_FOUND, "there is no such thing here")
        model, method = self._methods[path]
        return answer_json(method(model.model_validate(value)))

    def put(self, path: str, picture: bytes) -> Answer:
        """Keep a painted view, `painted/NAME.png`."""
        folder, _, name = path.partition("/")
        if folder != "painted" or self._painted is None:
            raise Refusal(HTTPStatus.NOT_FOUND, "there is no such thing here")
        with self._one_at_a_time:
            self._painted.take(unquote(name), picture)
        return answer_json(self._describe_painted(self._painted))

    def _forget(self, question: ForgetQuestion) -> dict[str, Any]:
        if self._painted is None or question.view not in self._painted.views():
            raise Refusal(HTTPStatus.NOT_FOUND, "there is no view of this name")
        self._painted.remove(question.view)
        return self._describe_painted(self._painted)

    def _describe_painted(self, painted: PaintedFolder) -> dict[str, Any]:
        return {"views": painted.views(), "file": str(painted.folder), "then": self._then}

    @property
    def _then(self) -> str:
        """The command that goes on, with what was painted where something is."""
        if self._painted is None or not any(self._painted.views().values()):
            return self._command
        return f"{self._command} --painted {shlex.quote(str(self._painted.folder))}"

    def _describe(self) -> dict[str, Any]:
        frames = [
            {"name": name, "size": self._subject.picture_size(index)}
            for index, name in enumerate(self._subject.names())
        ]
        saved, problem, segmenter = None, None, self._subject.scene.segmenter
        try:
            request = read_request(self._saved)
            saved = request.model_dump(mode="json") if request else None
        except ConfigurationError as error:
            problem = str(error)
        return {
            "title": self._title, "frames": frames, "missing": self._subject.missing,
            "finder": segmenter.name if segmenter else GRABCUT, "saved": saved,
            "problem": problem, "file": str(self._saved), "then": self._then,
            "painted": None if self._painted is None else self._describe_painted(self._painted),
        }  # fmt: skip

    def _picture(self, name: str, longest: int) -> bytes:
        with self._one_at_a_time:  # a decoded photo is large
            return self._encode(self._find_view(name), longest)

    def _find_view(self, name: str) -> int:
        names = self._subject.names()
        if name not in names:
            raise Refusal(HTTPStatus.NOT_FOUND, "there is no view of this name")
        return names.index(name)

    def _mask(self, question: MaskQuestion) -> dict[str, Any]:
        view = self._find_view(question.view)
        check_request(question.request.mask, self._subject)
        mask = mask_at_once(question.request.mask, self._subject, question.view, self._config, self._seed)
        if mask is None:
            return {"outline": None, "share": None}
        size = self._subject.picture_size(view)
        return {"outline": trace_outline(mask, *size), "share": float(mask.mean())}

    def _carry(self, question: CarryQuestion) -> dict[str, Any]:
        if self._subject.missing is not None:
            raise ConfigurationError(self._subject.missing)
        check_request(question.request.mask, self._subject)
        return {"number": self._carrier.ask(question.request)}

    def _progress(self, question: ProgressQuestion) -> dict[str, Any]:
        state = asdict(self._carrier.state())
        return state if question.revision != state["revision"] else state | {"outlines": None, "shares": None}

    def _save(self, question: SaveQuestion) -> dict[str, Any]:
        check_request(question.request.mask, self._subject)
        write_request(self._saved, question.request)
        return {"file": str(self._saved), "then": self._then}


@cache
def _read_bundle(name: str) -> bytes:
    return files(PACKAGE).joinpath("bundle", name).read_bytes()
