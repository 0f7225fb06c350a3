import os
import threading

import pytest
import torch

from inpaint3d.diffusion.training import Batch
from inpaint3d.stages.diffusion_training.ahead import MadeAhead, MadeByWorkers, make_ahead


def test_results_come_in_order_whatever_their_threads_do() -> None:
    late = threading.Event()

    def make(i: int) -> int:
        if i == 0:
            assert late.wait(10)
        if i == 3:
            late.set()
        return i

    # The first can only be finished once the fourth has been begun.
    assert list(MadeAhead(make, range(20), threads=4, ahead=4)) == list(range(20))


def test_the_next_is_made_while_one_is_used() -> None:
    begun = [threading.Event() for _ in range(4)]
    steps = MadeAhead(lambda i: begun[i].set(), range(4), threads=1, ahead=2)
    following = [i == 3 or begun[i + 1].wait(10) for i, _ in enumerate(steps)]
    assert following == [True] * 4


def test_no_more_is_made_ahead_than_was_asked_for() -> None:
    made: list[int] = []
    steps = iter(MadeAhead(made.append, range(100), threads=1, ahead=3))
    next(steps)
    steps.close()  # waits for what has been begun
    assert len(made) <= 4


def test_what_goes_wrong_is_raised_in_its_turn() -> None:
    steps = iter(MadeAhead(lambda i: 1 // (2 - i), range(10), threads=2, ahead=5))
    assert [next(steps), next(steps)] == [0, 1]
    with pytest.raises(ZeroDivisionError):
        next(steps)


def make_batch(index: int) -> tuple[int, Batch]:
    picture = torch.full((2, 3, 4, 4), float(index))
    return os.getpid(), Batch(picture, picture[:, :1], picture[:, :1])


def test_processes_make_what_threads_do() -> None:
    """In order, in other processes than this one."""
    made = list(MadeByWorkers(make_batch, range(5, 12), workers=2))
    assert [float(batch.image[0, 0, 0, 0]) for _, batch in made] == list(range(5, 12))
    assert os.getpid() not in {process for process, _ in made}


def test_a_gpu_is_fed_by_processes_and_a_processor_by_one_thread() -> None:
    assert isinstance(make_ahead(make_batch, range(2), "cuda"), MadeByWorkers)
    assert isinstance(make_ahead(make_batch, range(2), "cpu"), MadeAhead)
