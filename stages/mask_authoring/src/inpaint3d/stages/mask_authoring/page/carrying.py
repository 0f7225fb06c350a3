"""Masks carried to all views in the background: the latest request wins, the nearest views come first."""

import contextlib
import tempfile
import threading
import time
import traceback
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from inpaint3d.contracts.errors import Inpaint3dError, InterruptedRun
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import MaskRequest
from inpaint3d.contracts.models.artifacts.masks import ObjectRequest
from inpaint3d.scene.planes import Plane
from inpaint3d.stages.mask_authoring.author import author
from inpaint3d.stages.mask_authoring.authored import Authored
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.consistency import Agreement, measure_agreement
from inpaint3d.stages.mask_authoring.page.masks import Outline, trace_outline
from inpaint3d.stages.mask_authoring.page.pictures import Subject
from inpaint3d.stages.mask_authoring.requests import find_view
from inpaint3d.stages.mask_authoring.scene import Scene
from inpaint3d.stages.mask_authoring.surroundings import find_planes
from inpaint3d.stages.mask_authoring.views import camera_distances

NEAREST = 8
"""Views that an object is carried to before it is carried to all."""


@dataclass(frozen=True)
class Carried:
    """How far carrying is. `revision` counts the sets of outlines that there have been, over all requests."""

    number: int = 0
    revision: int = 0
    done: float = 0
    total: float = 0
    complete: bool = False
    error: str | None = None
    seconds: float = 0.0
    consistency: float | None = None
    outlines: dict[str, Outline] = field(default_factory=dict[str, Outline])
    shares: dict[str, float] = field(default_factory=dict[str, float])
    """Of each view's pixels, how many are in the hole."""
    to_check: tuple[str, ...] = ()
    """Views whose masks agree little with their neighbours'."""


class Carrier(threading.Thread):
    """Carries the last request that it was asked for; one that comes meanwhile ends the work on the one before."""

    def __init__(self, subject: Subject, config: Config, seed: int) -> None:
        super().__init__(name="carrying", daemon=True)
        self._subject, self._config, self._seed = subject, config, seed
        self._wake = threading.Condition()
        self._asked: MaskRequest | None = None
        self._running: Context | None = None
        self._planes: Sequence[Plane] | None = None
        self._state = Carried()
        self._closed = False

    def ask(self, request: MaskRequest) -> int:
        """Carry this from now on, and nothing else; the number that its state will have."""
        with self._wake:
            self._state = Carried(number=self._state.number + 1, revision=self._state.revision)
            self._asked = request
            if self._running is not None:
                self._running.stopping = True
            self._wake.notify()
            return self._state.number

    def state(self) -> Carried:
        """How far it is with the last request."""
        with self._wake:
            return self._state

    def close(self) -> None:
        """End the work, and wait for its end."""
        with self._wake:
            self._closed = True
            if self._running is not None:
                self._running.stopping = True
            self._wake.notify()
        self.join()

    def run(self) -> None:
        """Carry what is asked for, until it is closed."""
        while True:
            with self._wake:
                while self._asked is None and not self._closed:
                    self._wake.wait()
                if self._asked is None or self._closed:
                    return
                number, request, self._asked = self._state.number, self._asked, None
            self._carry(number, request)

    def _carry(self, number: int, request: MaskRequest) -> None:
        began = time.monotonic()
        try:
            for chosen in self._list_passes(request):
                shown = self._author(number, request, chosen)
                self._tell(number, seconds=round(time.monotonic() - began, 2), **shown)
            self._tell(number, complete=True)
        except InterruptedRun:
            return
        except Inpaint3dError as error:
            self._tell(number, complete=True, error=str(error))
        except Exception as error:  # a bug: it is to be seen, and the next request is to be carried all the same
            traceback.print_exc()
            self._tell(number, complete=True, error=f"{type(error).__name__}: {error}")

    def _list_passes(self, request: MaskRequest) -> list[list[int]]:
        """The views to carry to, first the nearest alone."""
        views = self._subject.scene.views
        everything = list(range(len(views)))
        if not isinstance(request.mask, ObjectRequest) or len(views) < 2 * NEAREST:
            return [everything]
        pointed = [find_view(views, prompts.view) for prompts in request.mask.prompts]
        apart = camera_distances([view.camera for view in views])[pointed].min(0)
        count = max(NEAREST + 1, len(pointed))  # those pointed at are at no distance
        return [sorted(np.argsort(apart, kind="stable")[:count].tolist()), everything]

    def _author(self, number: int, request: MaskRequest, chosen: Sequence[int]) -> dict[str, Any]:
        scene = self._find_scene()
        views, depth_views = [scene.views[i] for i in chosen], [scene.depth_views[i] for i in chosen]
        some = replace(scene, views=views, depth_views=depth_views)
        with self._open_context(number) as ctx:
            authored = author(request.mask, some, request.dilate, self._config, ctx)
            ctx.progress(len(chosen), len(chosen))
        sizes = [self._subject.picture_size(i) for i in chosen]
        outlines = [trace_outline(mask, *size) for mask, size in zip(authored.masks, sizes, strict=True)]
        names = [view.name for view in views]
        shown = {
            "outlines": dict(zip(names, outlines, strict=True)),
            "shares": {name: float(mask.mean()) for name, mask in zip(names, authored.masks, strict=True)},
        }
        agreement = self._measure(some, authored)
        return shown | {"consistency": agreement.set, "to_check": agreement.to_check(names)} if agreement else shown

    def _find_scene(self) -> Scene:
        """All views, with the planes of the scene, which are found once for all requests and passes."""
        scene = self._subject.scene
        if self._planes is None:
            self._planes = find_planes(scene.points, scene.small(self._config.segment_size))
        return replace(scene, planes=self._planes)

    def _measure(self, scene: Scene, authored: Authored) -> Agreement | None:
        """Of masks that have been carried to all views; volumes agree by construction."""
        if authored.primitives or len(scene.views) < len(self._subject.scene.views):
            return None
        return measure_agreement(scene.depth_views, authored.masks, self._config.depth_tolerance)

    @contextlib.contextmanager
    def _open_context(self, number: int) -> Generator[Context]:
        """What a request is carried in: its progress is told, and it ends where a newer one has come."""

        def emit(event: str, **values: Any) -> None:
            if event == "progress":
                self._tell(number, done=values["done"], total=values["total"])

        with tempfile.TemporaryDirectory(prefix="inpaint3d-page-") as work:
            ctx = Context(seed=self._seed, device="cpu", threads=1, work=Path(work), emit=emit)
            with self._wake:
                ctx.stopping = self._closed or number != self._state.number
                self._running = ctx
            try:
                yield ctx
            finally:
                with self._wake:
                    self._running = None

    def _tell(self, number: int, **values: Any) -> None:
        with self._wake:
            if number == self._state.number:
                revision = self._state.revision + ("outlines" in values)
                self._state = replace(self._state, revision=revision, **values)
