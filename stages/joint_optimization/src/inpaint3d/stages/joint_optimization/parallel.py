"""Data parallelism (S12): every rank takes its own rays and its own patch, and all step along their mean gradient.

Alone, the stage starts the other ranks as processes beside it; under torchrun they are there already, on this machine
and on others (`rank.py`).
"""

import contextlib
import os
import signal
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
import torch.multiprocessing as mp
from torch import Tensor

from inpaint3d.contracts.errors import ConfigurationError, InterruptedRun
from inpaint3d.contracts.kit.checkpoints import previous_of
from inpaint3d.contracts.kit.context import Context, Inputs
from inpaint3d.contracts.store.workspace import remove
from inpaint3d.stages.joint_optimization.config import Config

PATIENCE = timedelta(minutes=10)
"""How long a rank waits for the others before it gives up."""

Solve = Callable[[Config, Inputs, Context, "Ranks"], Any]


@dataclass(frozen=True)
class Ranks:
    """Which of how many processes this is, and which of how many on its machine, in torch.distributed's words. Alone,
    nothing below does anything.
    """

    rank: int = 0
    world_size: int = 1
    local_rank: int = 0
    local_world_size: int = 1

    def average(self, parameters: Iterable[Tensor]) -> None:
        """Replace every gradient by its mean over the ranks, which compute the same terms and so the same gradients."""
        if self.world_size > 1:
            for parameter in parameters:
                if parameter.grad is not None:
                    dist.all_reduce(parameter.grad)
                    parameter.grad /= self.world_size

    def agree(self, *decided: bool) -> list[bool]:
        """What the first rank decided."""
        if self.world_size == 1:
            return list(decided)
        flags = torch.tensor(decided, dtype=torch.int32, device=_choose_device())
        dist.broadcast(flags, src=0)
        return [bool(flag) for flag in flags.tolist()]

    def broadcast_file(self, file: Path) -> None:
        """Give every rank the first one's file, or none where it has none: other machines do not see its folder."""
        if self.world_size == 1:
            return
        first, device = self.rank == 0, _choose_device()
        kept = np.fromfile(file, np.uint8) if first and file.exists() else np.empty(0, np.uint8)
        size = torch.tensor([kept.size], device=device)
        dist.broadcast(size, src=0)
        data = torch.from_numpy(kept).to(device) if first else torch.empty(int(size), dtype=torch.uint8, device=device)
        if data.numel():
            dist.broadcast(data, src=0)
        if not first:
            # One of its own from an earlier run, in which it may have been the first, is not to be gone on from.
            remove(previous_of(file))
            self._replace(file, data)

    def _replace(self, file: Path, data: torch.Tensor) -> None:
        """The file anew, or none for no data. Ranks of one machine share it: none may ever see a part."""
        if not data.numel():
            file.unlink(missing_ok=True)
            return
        staged = file.with_suffix(f".{self.rank}")
        data.cpu().numpy().tofile(staged)
        staged.replace(file)

    def device(self, kind: str) -> str:
        """The rank's own GPU, or the processor."""
        return f"cuda:{self.local_rank}" if kind == "cuda" and self.world_size > 1 else kind


def _choose_device() -> str:
    """Where a tensor has to lie to be sent."""
    return "cuda" if dist.get_backend() == "nccl" else "cpu"


@contextlib.contextmanager
def start_ranks(count: int, solve: Solve, config: Config, inputs: Inputs, ctx: Context) -> Generator[Ranks]:
    """Make this process the first of `count` ranks; the others `solve` the same in processes of their own.

    They end with this one, whatever happens to it; if one of them fails, its next collective call fails here.
    """
    if count == 1:
        yield Ranks()
        return
    if dist.is_torchelastic_launched():
        with join_torchrun(count, ctx.device) as ranks:
            yield ranks
        return
    meeting = ctx.work / "ranks"
    meeting.unlink(missing_ok=True)  # of a run that was killed
    task = (config, inputs, ctx.seed, ctx.device, ctx.threads, ctx.work)
    spawn = mp.get_context("spawn")
    others = [spawn.Process(target=_follow, args=(r, count, solve, *task), daemon=True) for r in range(1, count)]
    for process in others:
        process.start()
    try:
        with _join_group(Ranks(0, count, 0, count), ctx.device, f"file://{meeting}") as ranks:
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
    with _join_group(Ranks(rank, count, rank, count), device, f"file://{work / 'ranks'}") as ranks:
        follow(config, inputs, solve, ranks, seed=seed, device=device, threads=threads, work=work)


def follow(
    config: Config, inputs: Inputs, solve: Solve, ranks: Ranks, *, seed: int, device: str, threads: int, work: Path
) -> None:
    """What a rank does that is not the first: step with the others, say nothing, leave nothing but in `work`."""
    # Whoever stops the run tells the first rank, which tells the others when to stop.
    for kind in (signal.SIGTERM, signal.SIGINT):
        signal.signal(kind, signal.SIG_IGN)
    own = work / f"rank-{ranks.rank}"
    own.mkdir(parents=True, exist_ok=True)
    ctx = _SilentContext(seed=seed, device=device, threads=threads, work=own, emit=_ignore)
    with contextlib.suppress(InterruptedRun):
        solve(config, inputs, ctx, ranks)


def _ignore(event: str, **values: Any) -> None:
    pass


class _SilentContext(Context):
    """The context of a rank that nobody listens to: the clocks and series of the run are the first rank's."""

    def progress(self, done: float, total: float, message: str = "", **figures: float) -> None:
        pass

    def record(self, series: str, **row: float | str) -> None:
        pass


@contextlib.contextmanager
def join_torchrun(count: int, device: str) -> Generator[Ranks]:
    """The rank that torchrun made of this process. ConfigurationError where it started another number of them."""
    names = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE")
    rank, started, local_rank, local_world_size = (int(os.environ[name]) for name in names)
    if started != count:
        raise ConfigurationError(
            f"torchrun started {started} processes, the parameter ranks says {count}; make them equal"
        )
    with _join_group(Ranks(rank, count, local_rank, local_world_size), device, "env://") as ranks:
        yield ranks


@contextlib.contextmanager
def _join_group(ranks: Ranks, device: str, meeting: str) -> Generator[Ranks]:
    if device == "cuda":
        torch.cuda.set_device(ranks.local_rank)
    backend = "nccl" if device == "cuda" else "gloo"
    dist.init_process_group(backend, meeting, PATIENCE, world_size=ranks.world_size, rank=ranks.rank)
    try:
        yield ranks
    finally:
        dist.destroy_process_group()
