"""The way around the scene: what the fields show along the capture's cameras, before and after."""

from dataclasses import dataclass
from pathlib import Path

from inpaint3d.contracts.models.artifacts import RadianceFieldArtifact
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.orchestrator.pages.pictures import choose_evenly, embed, read_size

FRAMES = 24
BUDGET_BYTES = 3 * 2**20
"""Of both rows of pictures together, as files."""


@dataclass(frozen=True)
class Orbit:
    """Pictures of both fields, in the capture's order; `before` may be empty."""

    names: tuple[str, ...]
    before: tuple[str, ...]
    after: tuple[str, ...]
    width: int
    height: int


def build_orbit(store: Store, before: Digest | None, after: Digest | None) -> Orbit | None:
    """From the fields' own renders of the capture's views; None where there is no field, or too few views to turn."""
    if after is None:
        return None
    late = _list_pictures(store.open(after, RadianceFieldArtifact))
    early = {} if before is None else _list_pictures(store.open(before, RadianceFieldArtifact))
    names = [name for name in late if not early or name in early]
    if len(names) < 3:
        return None
    chosen = choose_evenly(names, min(FRAMES, _count_affordable(late, early, names)))
    data = late[chosen[0]].read_bytes()
    width, height = read_size(data, late[chosen[0]])
    return Orbit(
        tuple(chosen),
        tuple(embed(early[n].read_bytes()) for n in chosen) if early else (),
        tuple(embed(late[n].read_bytes()) for n in chosen),
        width,
        height,
    )


def _list_pictures(field: Artifact[RadianceFieldArtifact]) -> dict[str, Path]:
    return {view.name: field.path(view.picture) for view in field.metadata.views}


def _count_affordable(late: dict[str, Path], early: dict[str, Path], names: list[str]) -> int:
    sizes = [sum(pictures[n].stat().st_size for pictures in (late, early) if n in pictures) for n in names]
    return max(1, int(BUDGET_BYTES / (sum(sizes) / len(sizes))))
