"""What tests of injected faults share: when a fault is put in, what it breaks, and what has to be said of it."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import torch
from safetensors.torch import load_file
from torch import Tensor

from inpaint3d.contracts.kit.context import Context

Run = TypeVar("Run")


@dataclass(frozen=True)
class Fault(Generic[Run]):
    """put: does the damage to a run, between two of its steps. said: what the message matches."""

    what: str
    put: Callable[[Run], None]
    said: str


def watch(work: Path, at: int, put: Callable[[], None] | None, *, again: bool = False) -> tuple[Context, list[str]]:
    """A context that does the damage when `at` steps are done, and the messages that are logged to it.

    again: whenever so many are done, not the first time alone.
    """
    waiting = [] if put is None else [put]

    class Watched(Context):
        def progress(self, done: float, total: float, message: str = "", **figures: float) -> None:
            if done == at and waiting:
                (waiting[0] if again else waiting.pop())()

    messages: list[str] = []

    def emit(event: str, **values: str) -> None:
        if values.get("message"):
            messages.append(values["message"])

    return Watched(seed=0, device="cpu", threads=1, work=work, emit=emit), messages


def set_number(tensor: Tensor, at: int | tuple[int, int], value: float) -> None:
    """at: an index of the tensor, or of its numbers in one row."""
    with torch.no_grad():
        (tensor.view(-1) if isinstance(at, int) else tensor)[at] = value


def break_next_gradient(parameter: Tensor, at: int, value: float) -> None:
    """One number of the next gradient that a step leaves at a tensor comes out broken, as from a kernel that failed."""

    def spoil(found: Tensor) -> None:
        handle.remove()
        if found.grad is not None:
            found.grad.view(-1)[at] = value

    handle = parameter.register_post_accumulate_grad_hook(spoil)


def assert_located(messages: list[str], said: str, at: int) -> None:
    """One of the messages says it, with the step that the fault was put in at; none blames the learning rate."""
    found = [message for message in messages if re.search(said, message)]
    assert found, messages
    assert all(re.search(rf"step {at}\b|after step {at + 1}\b", message) for message in found), found
    assert not any("lower the learning rate" in message for message in messages)


def assert_checkpoint_is_finite(path: Path) -> None:
    """Of its tensors those that belong to something, NAME.PART: a curve has empty cells."""
    kept = {name: tensor for name, tensor in load_file(path).items() if "." in name and tensor.is_floating_point()}
    assert kept
    assert [name for name, tensor in kept.items() if not tensor.isfinite().all()] == []
