"""A GPU that is none: tensors that say `cuda`, lie on the processor, and meet no tensor that does not say so.

Code that forgets to move a tensor works on a processor, where all tensors are alike. Under `pretend_cuda` it fails as
it would on a GPU: an operation on tensors of both kinds raises, and so does reading a pretended tensor as an array.
Which storages are pretended is kept by an operator's results: what is computed from pretended tensors is pretended too,
in the backward pass as well. Python that a backward pass calls (`torch.utils.checkpoint`) is not followed.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.multiprocessing.reductions import StorageWeakRef
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map_only

CUDA, CPU = torch.device("cuda"), torch.device("cpu")

# A weak reference keeps a storage's address from being given to another one. Kept for the process, as caches are.
_pretended: dict[int, StorageWeakRef] = {}
# Whether the function that runs was given pretended tensors: what it makes from nothing inside lies beside them.
_beside: list[bool] = [False]
# Operators that take tensors of two devices: moving, and looking up by indices that lie on the processor.
_MIXING = ("aten::copy_", "aten::_to_copy", "aten::index.Tensor", "aten::index_put_", "aten::_index_put_impl_")


def is_pretended(tensor: Tensor) -> bool:
    """Whether a tensor says that it is on the GPU."""
    with torch._C.DisableTorchFunction():
        return tensor.untyped_storage()._cdata in _pretended


def _pretend(tensor: Tensor) -> Tensor:
    with torch._C.DisableTorchFunction():
        storage = tensor.untyped_storage()
        _pretended.setdefault(storage._cdata, StorageWeakRef(storage))
    return tensor


class _Propagated(TorchDispatchMode):
    """Results of pretended tensors are pretended; others must not be among them."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        given = [t for t in tree_flatten((args, kwargs))[0] if isinstance(t, Tensor)]
        there = [t for t in given if is_pretended(t)]
        here = [t for t in given if t.ndim and not is_pretended(t)]
        name = func.name()
        mixing = name in _MIXING
        if there and here and not mixing:
            raise RuntimeError(
                f"{name}: expected all tensors to be on the same device, but found cuda {tuple(there[0].shape)} and "
                f"cpu {tuple(here[0].shape)}"
            )
        made = func(*args, **kwargs)
        # Where devices mix, the result lies where the first one does.
        if (there and (not mixing or is_pretended(given[0]))) or (not given and _beside[-1]):
            tree_map_only(Tensor, _pretend, made)
        return made


class _Announced(TorchFunctionMode):
    """Devices that are asked for by name, and what says where a tensor is."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        name = getattr(func, "__name__", "")
        if func == Tensor.device.__get__:  # made anew at each access: equal, never the same
            return CUDA if is_pretended(args[0]) else CPU
        if func == Tensor.is_cuda.__get__:
            return is_pretended(args[0])
        if name in ("numpy", "__array__") and is_pretended(args[0]):
            raise TypeError("can't convert cuda device type tensor to numpy; use Tensor.cpu() first")
        if func is Tensor.cpu:
            return _move(args[0], CPU)
        if func is Tensor.to:
            return self._to(func, args, kwargs)
        return self._make(func, args, kwargs)

    def _to(self, func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
        """`to` a device, a type, or both, or whatever another tensor has."""
        moved, wanted, rest = args[0], None, []
        for value in args[1:]:
            if isinstance(value, str | torch.device):
                wanted = torch.device(value)
            elif isinstance(value, Tensor):
                wanted = CUDA if is_pretended(value) else CPU
                rest.append(value.dtype)
            else:
                rest.append(value)
        if kwargs.get("device") is not None:
            wanted = torch.device(kwargs.pop("device"))
        if rest or kwargs:
            moved = func(moved, *rest, **kwargs) if any(isinstance(r, torch.dtype) for r in rest) or kwargs else moved
        return moved if wanted is None else _move(moved, wanted)

    def _make(self, func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
        """What makes tensors from nothing does so where it is told; a generator draws on its own device alone."""
        asked = kwargs.get("device")
        there = asked is not None and torch.device(asked).type == "cuda"
        generator = kwargs.get("generator")
        if isinstance(generator, _Generator) and not _agrees(generator, args, there):
            raise RuntimeError(f"expected a generator on another device than {generator.device}")
        if there:
            kwargs["device"] = "cpu"
        given = [t for t in tree_flatten((args, kwargs))[0] if isinstance(t, Tensor)]
        _beside.append(any(is_pretended(t) for t in given))
        try:
            made = func(*args, **kwargs)
        finally:
            _beside.pop()
        return tree_map_only(Tensor, _pretend, made) if there else made


def _agrees(generator: "_Generator", args: Any, there: bool) -> bool:
    own = any(isinstance(a, Tensor) and is_pretended(a) for a in args)
    return (generator.device.type == "cuda") == (there or own)


def _move(tensor: Tensor, device: torch.device) -> Tensor:
    if (device.type == "cuda") == is_pretended(tensor):
        return tensor
    with torch._C.DisableTorchFunction():
        apart = _Copied.apply(tensor, device.type == "cuda")
    assert isinstance(apart, Tensor)
    return apart


class _Copied(torch.autograd.Function):
    """A copy on the other device, whose gradient comes back."""

    @staticmethod
    def forward(ctx: Any, tensor: Tensor, there: bool) -> Tensor:
        ctx.there = there
        return _copy(tensor, there)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        return _copy(grads[0], not ctx.there), None


def _copy(tensor: Tensor, there: bool) -> Tensor:
    with torch._C._DisableTorchDispatch():
        copied = tensor.detach().clone()
    return _pretend(copied) if there else copied


class _Generator(torch.Generator):
    """Draws on the processor, and says where it was asked to."""

    def __new__(cls, device: torch.device | str = "cpu") -> "_Generator":
        made = super().__new__(cls)
        made.asked = torch.device(device)
        return made

    @property
    def device(self) -> torch.device:
        return CUDA if self.asked.type == "cuda" else CPU

    def manual_seed(self, seed: int) -> "_Generator":
        super().manual_seed(seed)
        return self


@contextmanager
def pretend_cuda(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """`device="cuda"` works, on the processor, and mixes with no other tensor."""
    monkeypatch.setattr(torch, "Generator", _Generator)
    with _Propagated(), _Announced():
        yield
