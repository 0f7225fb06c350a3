"""Photos, a video or a data set become a capture: find the frames, look at every one, carry them over."""

from pathlib import Path

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, Source, Truth
from inpaint3d.stages.capture_ingest.carry import Carried, carry
from inpaint3d.stages.capture_ingest.config import Config
from inpaint3d.stages.capture_ingest.found import FoundFrame
from inpaint3d.stages.capture_ingest.layouts import describe_folder, find


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Write `capture`, and `truth` where the source has views to score against."""
    source = inputs.one("source", Source)
    raw = source.root / "raw"
    try:
        _ingest(raw, config, outputs, ctx)
    except BadInputError as error:
        # The file to repair is the user's; the store's copy of it is of no use to anybody.
        raise BadInputError(f"{source.metadata.name}: {str(error).replace(f'{raw}/', '')}") from error


def _ingest(raw: Path, config: Config, outputs: Outputs, ctx: Context) -> None:
    found = find(raw, config, ctx.work)
    for note in found.notes:
        ctx.log(note)
    if len(found.frames) < 2:
        raise BadInputError(
            f"{len(found.frames)} pictures in {describe_folder(raw)} ({found.layout} layout); "
            "a scene needs at least 2, better 20 or more that overlap by half"
        )
    total = len(found.frames) + len(found.truth)
    frames = _carry_all(found.frames, outputs.folder("capture"), 0, total, ctx)
    outputs.write("capture", Capture(layout=found.layout, ordered=found.ordered, frames=frames))  # pyright: ignore[reportArgumentType]
    if found.truth:
        kept = _carry_all(found.truth, outputs.folder("truth"), len(frames), total, ctx)
        outputs.write("truth", Truth(frames=kept))


def _carry_all(
    frames: list[FoundFrame], folder: Path, first: int, total: int, ctx: Context
) -> tuple[CapturedFrame, ...]:
    carried: list[Carried] = []
    for i, frame in enumerate(frames):
        carried.append(carry(frame, folder))
        ctx.progress(first + i + 1, total, frame.name)
    for note in describe_carried(carried):
        ctx.log(note)
    return tuple(c.frame for c in carried)


def describe_carried(carried: list[Carried]) -> list[str]:
    """Notes on masks that say nothing, and on what is transparent."""

    def count(what: str, chosen: list[Carried]) -> list[str]:
        return [f"{len(chosen)} of {len(carried)} {what} ({chosen[0].frame.name})"] if chosen else []

    return [
        *count("masks are empty: nothing is to be removed there", [c for c in carried if c.mask_share == 0]),
        *count("masks cover the whole picture", [c for c in carried if c.mask_share == 1]),
        *count("pictures have transparent pixels, which are no evidence", [c for c in carried if c.transparent_share]),
    ]
