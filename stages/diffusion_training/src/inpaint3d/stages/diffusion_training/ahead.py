"""Work done ahead of being asked for, so that training never waits for a picture to be decoded."""

import itertools
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

T = TypeVar("T")


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
