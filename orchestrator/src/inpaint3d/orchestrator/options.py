"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated, Literal

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
Mask = Annotated[Path | None, typer.Option(help="mask request (YAML); default: masks that came with the capture")]
Preset = Annotated[
    str | None, typer.Option(help="draft, standard, creative, high, paper or spin-nerf; default: the pipeline's")
]
Set = Annotated[list[str] | None, typer.Option("--set", help="STAGE.PARAM=VALUE, or STAGE.seed=N; may be repeated")]
Scene = Annotated[list[str] | None, typer.Option("--scene", help="subfolder of CAPTURE; may be repeated: one run each")]
Only = Annotated[str | None, typer.Option(help="run this stage alone")]
From = Annotated[str | None, typer.Option("--from", help="run this stage and what depends on it")]
Until = Annotated[str | None, typer.Option(help="run up to this stage")]
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
AsJson = Annotated[bool, typer.Option("--json", help="as JSON")]

STORE = ".inpaint3d/store"
RUNS = Path("runs")
IMAGES = Path(".cache/images.yaml")
