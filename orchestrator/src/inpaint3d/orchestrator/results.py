"""What of a run's artifacts lies in `runs/NAME/`, where a person looks: one row for each kind."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inpaint3d.contracts.models.artifacts import CleanPlates, Evaluation, SplatScene, UsdScene
from inpaint3d.contracts.models.base import Closed
from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.store import Artifact, Store

METRICS, LOGS = "metrics.json", "logs"


@dataclass(frozen=True)
class Result:
    """An output of a node as it is published."""

    node: str
    port: str
    model: type[Closed]
    place: str
    """Its file or folder."""
    list_files: Callable[[Any], Mapping[str, str]]
    """Metadata -> path below the place ("": the place itself) -> path in the artifact."""

    def open(self, store: Store, record: RunRecord) -> Artifact[Any] | None:
        """The artifact; None where the run has none."""
        found = [n.outputs[self.port] for n in record.nodes if n.node == self.node and self.port in n.outputs]
        return store.open(found[0], self.model) if found else None


def _list_data_set(plates: CleanPlates) -> dict[str, str]:
    """The data set as other tools read it."""
    pictures = (file for plate in plates.plates for file in (plate.picture, plate.mask))
    return {file: file for file in (*plates.model, plates.transforms, *pictures)}


EVALUATION = Result(
    "evaluation", "evaluation", Evaluation, "pictures", lambda scores: {Path(p).name: p for p in scores.pictures}
)
RESULTS = (
    EVALUATION,
    Result("usd-export", "usd-scene", UsdScene, "scene.usdz", lambda scene: {"": scene.package}),
    Result("plate-export", "clean-plates", CleanPlates, "plates", _list_data_set),
    Result(
        "splat-export", "splat-scene", SplatScene, "splats", lambda scene: {file: file for file in scene.files.values()}
    ),
)
