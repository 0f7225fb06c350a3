"""Data parallelism (S12): every rank takes its own rays and its own patch, and all step along their mean gradient."""

import contextlib
import signal
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
import torch.multiprocessing as mp
from torch import Tensor

from inpaint3d.contracts.context import Context, Inputs
from inpaint3d.contracts.errors import InterruptedRun
from inpaint3d.stages.joint_optimization.config import Config

PATIENCE = timedelta(minutes=10)
"""How long a rank waits for the others before it gives up."""

Solve = Callable[[Config, Inputs, Context, "Ranks"], Any]


@dataclass(frozen=True)
class Ranks:
    """Which of how many processes this is. Alone, nothing below does anything."""

    rank: int = 0
    count: int = 1

    def average(self, parameters: Iterable[Tensor]) -> None:
        """Replace every gradient by its mean over the ranks, which compute the same terms and so the same gradients."""
        if self.count > 1:
            for parameter in parameters:
                if parameter.grad is not None:
                    dist.all_reduce(parameter.grad)
                    parameter.grad /= self.count

    def agreed(self, *decided: bool) -> list[bool]:
        """What the first rank decided."""
        if self.count == 1:
            return list(decided)
        flags = torch.tensor(decided, dtype=torch.int32, device="cuda" if dist.get_backend() == "nccl" else "cpu")
        dist.broadcast(flags, src=0)
        return [bool(flag) for flag in flags.tolist()]

    def wait(self) -> None:
        """Until every rank is here."""
        if self.count > 1:
            dist.barrier()

    def device(self, kind: str) -> str:
        """The rank's own GPU, or the processor."""
        return f"cuda:{self.rank}" if kind == "cuda" and self.count > 1 else kind


@contextlib.contextmanager
def together(count: int, solve: Solve, config: Config, inputs: Inputs, ctx: Context) -> Generator[Ranks]:
    """Make this process the first of `count` ranks; the others `solve` the same in processes of their own.

    They end with this one, whatever happens to it; if one of them fails, its next collective call fails here.
    """
    if count == 1:
        yield Ranks()
        return
    meeting = ctx.work / "ranks"
    meeting.unlink(missing_ok=True)  # of a run that was killed
    task = (config, inputs, ctx.seed, ctx.device, ctx.threads, ctx.work)
    spawn = mp.get_context("spawn")
    others = [spawn.Process(target=_follow, args=(r, count, solve, *task), daemon=True) for r in range(1, count)]
    for process in others:
        process.start()
    try:
        with _group(0, count, ctx.device, meeting) as ranks:
            yield ranks
            for process in others:
                process.join()
    finally:
        for process in others:
            process.terminate()


def _follow(
    rank: int,
    count: int,
    solve: Solve,
    config: Config,
    inputs: Inputs,
    seed: int,
    device: str,
    threads: int,
    work: Path,
) -> None:
    # Whoever stops the run tells the first rank, which tells the others when to stop.
    for kind in (signal.SIGTERM, signal.SIGINT):
        signal.signal(kind, signal.SIG_IGN)
    ctx = _Quiet(seed=seed, device=device, threads=threads, work=work, emit=_nothing)
    with _group(rank, count, device, work / "ranks") as ranks, contextlib.suppress(InterruptedRun):
        solve(config, inputs, ctx, ranks)


def _nothing(event: str, **values: Any) -> None:
    pass


class _Quiet(Context):
    """The context of a rank that nobody listens to: the clocks and series of the run are the first rank's."""

    def progress(self, done: float, total: float, message: str = "", **figures: float) -> None:
        pass

    def record(self, series: str, **row: float | str) -> None:
        pass


@contextlib.contextmanager
def _group(rank: int, count: int, device: str, meeting: Path) -> Generator[Ranks]:
    if device == "cuda":
        torch.cuda.set_device(rank)
    backend = "nccl" if device == "cuda" else "gloo"
    dist.init_process_group(backend, f"file://{meeting}", PATIENCE, world_size=count, rank=rank)
    try:
        yield Ranks(rank, count)
    finally:
        dist.destroy_process_group()
