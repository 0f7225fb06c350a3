"""Arguments and options that several commands share, one by one and in the groups that belong together."""

import functools
import inspect
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_origin, get_type_hints

import typer

StorePath = Annotated[
    str,
    typer.Option("--store", envvar="INPAINT3D_STORE", help="where artifacts are kept: a folder, or s3://BUCKET/PREFIX"),
]
RunsPath = Annotated[
    Path, typer.Option("--runs-dir", envvar="INPAINT3D_RUNS", help="where results are left to look at")
]
Name = Annotated[str | None, typer.Option(help="name of the run; default: the capture's folder name")]
Capture = Annotated[Path, typer.Argument(help="a folder of photos, a data set, or a video file")]
Mask = Annotated[
    Path | None,
    typer.Option(
        help="mask request (YAML); default: the run folder's mask.yaml, else masks that came with the capture"
    ),
]
Preset = Annotated[
    str | None, typer.Option(help="draft, standard, creative, high, paper or spin-nerf; default: the pipeline's")
]
Set = Annotated[list[str] | None, typer.Option("--set", help="STAGE.PARAM=VALUE, or STAGE.seed=N; may be repeated")]
Effects = Annotated[
    list[str] | None,
    typer.Option("--effect", help="NAME=on|off|auto: overrule what scene analysis decides; may be repeated"),
]
Scene = Annotated[list[str] | None, typer.Option("--scene", help="subfolder of CAPTURE; may be repeated: one run each")]
Only = Annotated[str | None, typer.Option(help="run this stage alone")]
From = Annotated[str | None, typer.Option("--from", help="run this stage and what depends on it")]
Until = Annotated[str | None, typer.Option(help="run up to this stage")]
Compare = Annotated[bool, typer.Option("--compare", help="also run the controls that the result is compared with")]
Force = Annotated[bool, typer.Option("--force", help="compute again what is selected, even if up to date")]
PipelinePath = Annotated[Path | None, typer.Option("--pipeline", help="default: the nearest pipeline.yaml")]
LogFormat = Annotated[
    Literal["auto", "table", "json"],
    typer.Option(help="auto (a table on a terminal, JSON lines elsewhere), table, json"),
]
Seed = Annotated[int, typer.Option(help="seed of every stage")]
Device = Annotated[Literal["cpu", "cuda"], typer.Option(help="what stages that can use a GPU run on")]
RunnerName = Annotated[
    Literal["process", "container"],
    typer.Option(
        "--runner", envvar="INPAINT3D_RUNNER", help="each stage in this environment, or in an image of its own"
    ),
]
Engine = Annotated[
    str | None, typer.Option(envvar="INPAINT3D_ENGINE", help="for containers; default: podman or docker, as found")
]
Images = Annotated[
    Path, typer.Option("--images", envvar="INPAINT3D_IMAGES", help="images.yaml, as `make images` wrote it")
]
Stub = Annotated[bool, typer.Option("--stub", help="run every stage's stub: the whole DAG in seconds, no numeric work")]
Prior = Annotated[
    Path | None,
    typer.Option(
        help="folder of a diffusion-prior artifact to start from, or a diffusers pipeline to ask: its folder, or its "
        "name in the hub's cache"
    ),
]
Corpus = Annotated[Path | None, typer.Option(help="folder of an image-corpus artifact to train the prior on")]
Want = Annotated[
    list[str] | None,
    typer.Option(
        "--want", help="also run this stage, which no preset wants (plate-export, splat-export); may be repeated"
    ),
]
Painted = Annotated[
    Path | None, typer.Option(help="folder that `inpaint3d paint ask` wrote, painted in: what is made up, by hand")
]
TimeBudget = Annotated[
    str | None, typer.Option(metavar="TIME", help="what the stages after the cameras may take: 90s, 5m, 1h")
]
MemoryBudget = Annotated[str | None, typer.Option(metavar="SIZE", help="what a stage may hold at once: 800M, 4G")]
TargetPsnr = Annotated[
    float | None, typer.Option(help="dB in the hole; the cheapest point of the study that reached it is taken")
]
StudyPath = Annotated[
    Path | None, typer.Option("--study", help="points.json of a study; default: the one that comes with the pipeline")
]
Segmenter = Annotated[
    tuple[Path, Path] | None,
    typer.Option(
        metavar="ENCODER DECODER",
        help="two ONNX files of the Segment Anything family, which cut out what is pointed at; default: GrabCut",
    ),
]
Wait = Annotated[bool, typer.Option("--wait", help="wait for another run of the same name to end")]
Replace = Annotated[bool, typer.Option("--replace", help="take over a name whose last run was of another capture")]
AcceptDoubtful = Annotated[
    bool, typer.Option("--accept-doubtful", help="go on where a result cannot be right; the report begins with why")
]
ShowEffects = Annotated[
    bool, typer.Option("--effects", help="run up to the analysis, and print which effects the capture calls for")
]
AsJson = Annotated[bool, typer.Option("--json", help="as JSON")]

STORE = ".inpaint3d/store"
RUNS = Path("runs")
IMAGES = Path(".cache/images.yaml")


@dataclass(frozen=True)
class Request:
    """What is asked of the pipeline, alike for every scene."""

    preset: Preset = None
    assignments: Set = None
    effect: Effects = None
    prior: Prior = None
    corpus: Corpus = None
    seed: Seed = 0
    device: Device = "cpu"
    stub: Stub = False
    pipeline: PipelinePath = None
    # No options of every command: those of `SceneRequest` have them.
    mask: Path | None = None
    compare: bool = False
    painted: Path | None = None
    segmenter: tuple[Path, Path] | None = None
    want: list[str] | None = None


@dataclass(frozen=True)
class SceneRequest(Request):
    """What may be asked where the scenes are somebody's own."""

    mask: Mask = None
    compare: Compare = False
    painted: Painted = None
    segmenter: Segmenter = None
    want: Want = None


@dataclass(frozen=True)
class Budget:
    """What a run may take, or what it is to reach; the settings follow from a study."""

    time_budget: TimeBudget = None
    memory_budget: MemoryBudget = None
    target_psnr: TargetPsnr = None
    study: StudyPath = None

    @property
    def is_set(self) -> bool:
        return not (self.time_budget is None and self.memory_budget is None and self.target_psnr is None)


@dataclass(frozen=True)
class Places:
    """Where artifacts are kept, and where results are left."""

    store: StorePath = STORE
    runs_dir: RunsPath = RUNS


@dataclass(frozen=True)
class Environment:
    """What stages run in."""

    runner: RunnerName = "process"
    images: Images = IMAGES
    engine: Engine = None


@dataclass(frozen=True)
class Execution:
    """How a run goes on, whatever it is asked for."""

    log_format: LogFormat = "auto"
    wait: Wait = False
    replace: Replace = False
    accept_doubtful: AcceptDoubtful = False


def with_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command as typer reads it: a parameter whose type is a dataclass becomes an option for each of its fields.

    Options are the fields whose types are annotated ones.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, dict[str, inspect.Parameter]] = {}
    flat: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        if is_dataclass(hints[name]):
            groups[name] = _make_options(hints[name])
            flat += groups[name].values()
        else:
            flat.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[name]))

    @functools.wraps(command)
    def expanded(**given: Any) -> Any:
        made = {name: hints[name](**{o: given.pop(o) for o in options}) for name, options in groups.items()}
        return command(**given, **made)

    expanded.__dict__["__signature__"] = inspect.Signature(flat)
    expanded.__annotations__ = {parameter.name: parameter.annotation for parameter in flat}
    return expanded


def _make_options(group: Any) -> dict[str, inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return {
        field.name: inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.default is MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in fields(group)
        if get_origin(hints[field.name]) is Annotated
    }
