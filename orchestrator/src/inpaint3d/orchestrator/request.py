"""What a command line asks, checked before anything starts, and the planners of its scenes."""

from collections.abc import Mapping
from pathlib import Path

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.cluster import Image
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import Store
from inpaint3d.orchestrator.configure import Settings, configure
from inpaint3d.orchestrator.effects import switch_effects
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.intake import (
    CORPUS,
    DIFFUSERS,
    MASK_REQUEST,
    PAINTED,
    PRIOR,
    SEGMENTER,
    Given,
    list_externals,
    locate_externals,
    name_run,
    take_externals,
)
from inpaint3d.orchestrator.options import Request
from inpaint3d.orchestrator.parameters import parse_overrides
from inpaint3d.orchestrator.plan import Planner, Selection, find_pipeline

OPTIONS = {
    MASK_REQUEST: "--mask", PRIOR: "--prior", DIFFUSERS: "--prior", CORPUS: "--corpus", PAINTED: "--painted",
    SEGMENTER: "--segmenter",
}  # fmt: skip


class ConfiguredRequest:
    """A request with its pipeline configured."""

    def __init__(self, request: Request, selection: Selection) -> None:
        """Raises ConfigurationError for what cannot be, and for what would change nothing."""
        self.request, self.whole = request, Pipeline(find_pipeline(request.pipeline))
        preset = request.preset or self.whole.spec.spec.defaultPreset
        self.overrides = switch_effects(
            self.whole.under(preset),
            request.effect or [],
            parse_overrides(self.whole.under(preset), request.assignments or []),
        )
        self.paths = locate_externals(
            mask=request.mask,
            prior=request.prior,
            corpus=request.corpus,
            painted=request.painted,
            segmenter=request.segmenter,
        )
        if unknown := [node for node in request.want or () if node not in self.whole.order]:
            raise ConfigurationError(
                f"--want {unknown[0]}: no such stage in {self.whole.path}; there are {', '.join(self.whole.order)}"
            )
        self.pipeline = configure(
            self.whole,
            Settings(preset, self.overrides, request.compare, request.seed, (*selection.named, *(request.want or ()))),
            list_externals(self.whole, self.paths),
            {external: _spell(external, given) for external, given in self.paths.items()},
        )
        selection.nodes(self.pipeline.pipeline)

    def take_externals(self, store: Store, capture: Path) -> dict[str, Digest]:
        """What a scene's nodes read from outside, taken into the store."""
        return take_externals(store, self.pipeline.pipeline, capture, self.paths)

    def planner(
        self, store: Store, capture: Path, name: str | None, images: Mapping[str, Image] | None = None
    ) -> Planner:
        """The planner of a scene, its externals taken into the store."""
        return Planner(
            configured=self.pipeline,
            store=store,
            history=History(store),
            name=name_run(capture, name),
            externals=self.take_externals(store, capture),
            mask=self.request.mask,
            device=self.request.device,
            stub=self.request.stub,
            images=images,
        )


def _spell(external: str, given: Given) -> str:
    """As the command line has it."""
    return " ".join(map(str, (OPTIONS[external], *(given if isinstance(given, tuple) else (given,)))))
