"""`runs/NAME/metrics.json` and the record of a run: what ran, why, how long, and what came out."""

from typing import Annotated, Any, Literal

from pydantic import Field

from inpaint3d.contracts.models.artifacts.results import Protocol
from inpaint3d.contracts.models.base import Closed, Digest

Status = Literal["cached", "done", "failed", "waiting", "stopped", "skipped", "pending", "left-out"]


class Change(Closed):
    """One difference between the key of a node's run and the one before it."""

    component: str = Field(description="e.g. parameters.guidance, inputs.mask-set, code")
    old: Any = None
    new: Any = None


class NodeRun(Closed):
    """One node in one run."""

    node: str
    status: Status
    reason: str = Field(description="why it ran, did not have to, or was left out: nothing asks for it")
    changes: tuple[Change, ...] = ()
    key: Digest | None = None
    components: dict[str, Any] = {}
    outputs: dict[str, Digest] = {}
    wall_s: float | None = Field(
        default=None, description="of the run that computed the result, which may be an earlier one"
    )
    cpu_s: float | None = None
    peak_memory_bytes: int | None = None
    non_finite: dict[str, int] = {}
    error: str | None = None
    exit_code: int | None = None

    @property
    def cached(self) -> bool:
        return self.status == "cached"


class Machine(Closed):
    processor: str
    cores: Annotated[int, Field(ge=1)]
    memory_bytes: int
    python: str


class RunRecord(Closed):
    """A run of the pipeline over one scene; lies in the store as `runs/NAME/ID.json`."""

    id: str
    name: str
    pipeline: str
    preset: str | None
    externals: dict[str, Digest]
    status: Literal["running", "done", "failed", "waiting", "stopped"]
    started: str
    finished: str | None = None
    wall_s: float | None = None
    error: str | None = Field(default=None, description="why the run itself ended early, where no node says it")
    process: str | None = Field(default=None, description="what runs it, or ran it: `store.Owner`")
    machine: Machine
    nodes: tuple[NodeRun, ...] = ()


class StageFigures(Closed):
    """What one stage cost."""

    node: str
    status: Status
    reason: str = Field(description="why it ran, did not have to, or was left out: nothing asks for it")
    cached: bool
    wall_s: float | None
    cpu_s: float | None
    peak_memory_bytes: int | None
    key: Digest | None
    outputs: dict[str, Digest]
    non_finite: dict[str, int]


class RunReport(Closed):
    """`metrics.json`: metrics by protocol, and per stage time, memory, whether it was cached, and digests."""

    version: Literal["1.0"] = "1.0"
    name: str
    run: str
    preset: str | None
    status: str
    machine: Machine
    stages: tuple[StageFigures, ...]
    protocols: tuple[Protocol, ...] = Field(description="empty until evaluation has run")
