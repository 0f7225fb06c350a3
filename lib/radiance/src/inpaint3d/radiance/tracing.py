"""Where the first number of a step that is not finite came from: the step is done again, every operation watched."""

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.health import find_non_finite
from inpaint3d.radiance.rays import Rays
from inpaint3d.scene.cameras import Camera

NamedCameras = Sequence[tuple[str, Camera]]
# They compute nothing: they reserve memory, which may hold anything, or pass on what they were given.
PASSING_ON = frozenset([
    "empty", "new_empty", "empty_like", "empty_strided", "new_empty_strided", "resize_", "fill_", "fill", "copy_",
    "copy", "_to_copy", "clone", "lift_fresh", "detach", "alias", "as_strided", "select", "slice", "split",
    "split_with_sizes", "unbind", "view", "_unsafe_view", "reshape", "expand", "t", "transpose", "permute", "squeeze",
    "unsqueeze", "cat", "stack", "index", "index_select", "index_put_", "gather",
])  # fmt: skip


@dataclass(frozen=True)
class Origin:
    """The first operation with a result that is not finite."""

    operation: str
    function: str
    given: bool  # one of its arguments was not finite already
    index: tuple[int, ...]
    shape: tuple[int, ...]
    rays: Rays | None  # those that were rendered there

    def describe(self, cameras: NamedCameras) -> str:
        """In words, with the ray, its view and pixel where it belongs to one."""
        what = "was given" if self.given else "made"
        words = f"{self.function} {what} the first at {list(self.index)} of {list(self.shape)} ({self.operation})"
        ray = None if self.rays is None else _find_row(self.index, self.shape, len(self.rays.origins))
        if ray is None or self.rays is None or not cameras:
            return words
        return f"{words}: ray {ray}, {describe_ray(self.rays, ray, cameras)}"


def trace_step(field: RadianceField, replay: Callable[[], Mapping[str, Tensor]], cameras: NamedCameras) -> str:
    """What made the first non-finite number of a step, in words: tensor, operation, ray, pixel and frame.

    replay: computes the step's terms again. It runs in readable torch, forward and backward, and moves no parameter.
    """
    if found := find_non_finite(dict(field.named_parameters())):
        return f"weights were not finite before the step: {', '.join(map(str, found))}"
    watch = _Watch()
    field.zero_grad()
    with field.on_backend("reference"), watch:
        terms = replay()
        if watch.origin is None:
            torch.stack([term for term in terms.values() if term.requires_grad]).sum().backward()
    origin = watch.origin
    gradients = {name: p.grad for name, p in field.named_parameters() if p.grad is not None}
    broken = find_non_finite(gradients)
    field.zero_grad()
    if origin is None:
        return "done again, the step is finite: the fault did not repeat"
    said = origin.describe(cameras)
    return f"{said}; gradients of {', '.join(map(str, broken))}" if broken else said


def describe_ray(rays: Rays, index: int, cameras: NamedCameras) -> str:
    """`view NAME, pixel (column, row)`: of the camera that stands where the ray begins and sees where it goes."""
    origin, direction = (part[index].detach().cpu().double().numpy() for part in (rays.origins, rays.directions))
    if not np.isfinite((origin, direction)).all():
        return f"which itself is not finite (origin {origin.tolist()}, direction {direction.tolist()})"
    best = None
    for name, camera in cameras:
        xy, z = camera.project(origin + direction)
        away = float(np.linalg.norm(camera.centre - origin)) + (0.0 if camera.inside(xy, z) else 1e-3)
        if best is None or away < best[0]:
            best = (away, f"view {name}, pixel ({int(np.floor(xy[0]))}, {int(np.floor(xy[1]))})")
    return "of no view" if best is None else best[1]


def _find_row(index: tuple[int, ...], shape: tuple[int, ...], rays: int) -> int | None:
    """The ray of a number: rows count rays, or samples ray by ray; some operations keep them last."""
    for at in (0, -1):
        if index and rays and shape[at] >= rays and shape[at] % rays == 0:
            return index[at] // (shape[at] // rays)
    return index[0] if len(index) and index[0] < rays else None


class _Watch(TorchDispatchMode):
    """Remembers the first operation whose result is not finite."""

    def __init__(self) -> None:
        super().__init__()
        self.origin: Origin | None = None
        self._rays: Rays | None = None

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        arguments = [t for t in _list_tensors((args, kwargs)) if self.origin is None]
        made = func(*args, **(kwargs or {}))
        name = str(func).removeprefix("aten.").partition(".")[0]
        if self.origin is None and name not in PASSING_ON:
            rays = next((f.f_locals.get("flat") for f in _walk_frames() if f.f_code.co_name == "render"), None)
            self._rays = rays if isinstance(rays, Rays) else self._rays
            for tensor in _list_tensors(made):
                if found := find_non_finite({"": tensor}):
                    given = bool(find_non_finite({str(i): t for i, t in enumerate(arguments)}))
                    self.origin = Origin(name, _name_function(), given, found[0].first, tuple(tensor.shape), self._rays)
                    break
        return made


def _list_tensors(value: Any) -> Iterator[Tensor]:
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from _list_tensors(part)
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from _list_tensors(part)


def _walk_frames() -> Iterator[FrameType]:
    frame = inspect.currentframe()
    while frame is not None:
        yield frame
        frame = frame.f_back


def _name_function() -> str:
    """The innermost function of ours, or the node of the backward pass."""
    node = torch._C._current_autograd_node()
    for frame in _walk_frames():
        module = str(frame.f_globals.get("__name__", ""))
        if module.startswith("inpaint3d.") and module != __name__:
            return f"{module.removeprefix('inpaint3d.')}.{frame.f_code.co_name}{', backward' if node else ''}"
    return "an operation" if node is None else f"the gradient of {node.name()}"
