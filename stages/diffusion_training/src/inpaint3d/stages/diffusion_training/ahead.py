"""Work done ahead of being asked for, so that training never waits for a picture to be decoded."""

import itertools
import os
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Generic, TypeVar

import torch
from torch.utils.data import DataLoader, Dataset

T = TypeVar("T")

AHEAD = 3
"""Results made while others are used, by one thread; of each worker process two."""
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - of processes
ENOUGH_SHARED_MEMORY = 4 * 2**30
"""Bytes that results of worker processes, which travel through it, may take up."""


class MadeAhead(Generic[T]):
    """make(index) for each index, in order, made by threads up to `ahead` results early.

    waited_s: seconds that whoever iterates had to wait, the first result included. What `make` raises comes out in its
    turn.
    """

    def __init__(self, make: Callable[[int], T], indices: Iterable[int], *, threads: int, ahead: int) -> None:
        self.make, self.indices, self.threads, self.ahead = make, iter(indices), threads, ahead
        self.waited_s = 0.0

    def __iter__(self) -> Iterator[T]:
        with ThreadPoolExecutor(self.threads) as pool:
            pending = deque(pool.submit(self.make, i) for i in itertools.islice(self.indices, self.ahead))
            try:
                while pending:
                    start = time.perf_counter()
                    result = pending.popleft().result()
                    self.waited_s += time.perf_counter() - start
                    pending.extend(pool.submit(self.make, i) for i in itertools.islice(self.indices, 1))
                    yield result
            finally:
                for future in pending:
                    future.cancel()


class MadeByWorkers(Generic[T]):
    """The same by processes, in memory that a GPU reads by itself: threads would wait for one interpreter's lock."""

    def __init__(self, make: Callable[[int], T], indices: Sequence[int], *, workers: int) -> None:
        self.loader: Iterable[T] = DataLoader(
            _Made(make, indices),
            batch_size=None,
            collate_fn=_keep_as_is,
            num_workers=workers,
            prefetch_factor=2,
            pin_memory=torch.cuda.is_available(),
            multiprocessing_context="fork",
        )
        self.waited_s = 0.0

    def __iter__(self) -> Iterator[T]:
        results = iter(self.loader)
        while True:
            start = time.perf_counter()
            try:
                result = next(results)
            except StopIteration:
                return
            self.waited_s += time.perf_counter() - start
            yield result


def make_ahead(make: Callable[[int], T], indices: Sequence[int], device: str) -> MadeAhead[T] | MadeByWorkers[T]:
    """make(index) for each index, by one thread beside a processor that is busy itself, by all cores for a GPU."""
    if device == "cpu":
        return MadeAhead(make, indices, threads=1, ahead=AHEAD)
    workers = max(1, (os.cpu_count() or 1) - 1)
    if SHARED_MEMORY.is_dir() and shutil.disk_usage(SHARED_MEMORY).free > ENOUGH_SHARED_MEMORY:
        return MadeByWorkers(make, indices, workers=workers)
    return MadeAhead(make, indices, threads=workers, ahead=2 * workers)


class _Made(Dataset[T], Generic[T]):
    def __init__(self, make: Callable[[int], T], indices: Sequence[int]) -> None:
        self.make, self.indices = make, indices

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int) -> T:
        return self.make(self.indices[index])


def _keep_as_is(made: T) -> T:
    return made
