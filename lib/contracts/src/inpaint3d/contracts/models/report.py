"""`runs/NAME/metrics.json` and the record of a run: what ran, why, how long, and what came out."""

import json
from typing import Annotated, Any, Literal, cast

from pydantic import Field

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts.effects import Effect
from inpaint3d.contracts.models.artifacts.results import Protocol
from inpaint3d.contracts.models.base import Closed, Digest, Finite
from inpaint3d.contracts.models.canonical import digest_of

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
    after: tuple[str, ...] = Field(default=(), description="the nodes whose results it reads")
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
    doubts: tuple[str, ...] = Field(default=(), description="why its result cannot be right")
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
    command: tuple[str, ...] = Field(default=(), description="the command line that began it; empty: none did")
    preset: str | None
    externals: dict[str, Digest]
    status: Literal["running", "done", "failed", "waiting", "stopped"]
    started: str
    finished: str | None = None
    wall_s: float | None = None
    error: str | None = Field(default=None, description="why the run itself ended early, where no node says it")
    process: str | None = Field(default=None, description="what runs it, or ran it: `store.Owner`")
    machine: Machine | None = Field(description="what it ran on; None: a cluster, each stage on one of its machines")
    nodes: tuple[NodeRun, ...] = ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the results cannot be right, by node."""
        return tuple(f"{n.node}: {doubt}" for n in self.nodes for doubt in n.doubts)

    def encode(self) -> bytes:
        """The file's bytes: JSON with the digest of all the rest in it."""
        body = self.model_dump(mode="json")
        return json.dumps({"digest": digest_of(body), **body}, indent=1).encode()

    @classmethod
    def decode(cls, data: bytes) -> "RunRecord":
        """The record that a file is; ValueError where it was damaged, or has what this version does not know."""
        return cls.model_validate(read_run_document(data))


def read_run_document(data: bytes) -> dict[str, Any]:
    """What a run's record says, in whatever version; ValueError where it is none or does not hash to its digest."""
    try:
        value = json.loads(data)
        if not isinstance(value, dict):
            raise ValueError("it is no mapping")
        body = cast(dict[str, Any], value)
        digest = body.pop("digest", None)
        if digest is not None and digest != digest_of(body):
            raise ValueError("it does not hash to its digest")
    except (RecursionError, ConfigurationError) as error:
        raise ValueError("it is no JSON") from error
    return body


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


class AccuracySample(Closed):
    """How well a stage's field showed held-out pixels at a moment of the run, stages counted one after another."""

    node: str
    wall_s: Finite
    cpu_s: Finite
    psnr: Finite = Field(description="dB, on known pixels of photos kept out of training")


class AccuracyCourse(Closed):
    """Accuracy of a whole run against the seconds since its start."""

    samples: tuple[AccuracySample, ...]
    in_hand_from: str = Field(description="stage whose field is the first without what is to go")
    knee: AccuracySample | None = Field(description="where the curve in hand bends; None: it does not")
    half: AccuracySample = Field(description="half of the way from the first field in hand to the last")
    last: AccuracySample
    ahead_s: Finite = Field(description="CPU seconds more that the gain is of")
    gain_db: Finite | None = Field(description="what they would buy, by a power law; None: too few scores")
    gain_low_db: Finite | None = Field(description="lower end of its 95 % interval, by resampled residuals")
    gain_high_db: Finite | None
    sentence: str


class EffectFigures(Closed):
    """A decision on an effect, and its cost, measured on the machine that decided with a field of standard size."""

    effect: Effect
    step_ratio: float | None = Field(default=None, description="CPU time of a training step over the plain field's")
    step_cpu_ms: float | None = None
    learnt_bytes: float | None = Field(
        default=None, description="of what is learnt for it: parameters, gradients, the optimiser's moments"
    )


class RunReport(Closed):
    """`metrics.json`: metrics by protocol, and per stage time, memory, whether it was cached, and digests."""

    version: Literal["1.0"] = "1.0"
    name: str
    run: str
    preset: str | None
    status: str
    doubts: tuple[str, ...] = Field(default=(), description="why the results cannot be right: node: reason")
    machine: Machine | None = Field(description="what it ran on; None: a cluster, each stage on one of its machines")
    stages: tuple[StageFigures, ...]
    effects: tuple[EffectFigures, ...] = Field(default=(), description="empty until scene-analysis has run")
    protocols: tuple[Protocol, ...] = Field(description="empty until evaluation has run")
    course: AccuracyCourse | None = Field(default=None, description="None where no stage scored a field")
