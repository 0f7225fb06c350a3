"""Data-parallel training: equal processes that each learn from other pictures and share their gradients (S12, D12).

Started by torchrun; gloo between processors, nccl between GPUs. Where there is one process alone, nothing is done.
"""

import os
from collections.abc import Sequence

import torch
import torch.distributed as dist
from torch import Tensor


def join_ranks(device: str = "cpu") -> str:
    """Meet the other processes that torchrun started; without torchrun, stay alone. Returns this rank's own device."""
    if not dist.is_torchelastic_launched():
        return device
    if device == "cuda":
        device = f"cuda:{os.environ['LOCAL_RANK']}"
        torch.cuda.set_device(device)
    if not dist.is_initialized():
        dist.init_process_group("gloo" if device == "cpu" else "nccl")
    return device


def leave_ranks() -> None:
    if dist.is_initialized():
        dist.destroy_process_group()


def rank() -> int:
    return dist.get_rank() if dist.is_initialized() else 0


def ranks() -> int:
    return dist.get_world_size() if dist.is_initialized() else 1


def own_parts(parts: int) -> range:
    """Which of the parts 0, 1, ... of a step's batch are this rank's.

    Parts are numbered over all ranks, so that what is learnt does not depend on how many there are. Raises ValueError
    where they cannot be shared out equally.
    """
    if parts % ranks():
        raise ValueError(f"{parts} parts of a batch cannot be shared equally by {ranks()} ranks; give a multiple")
    return range(rank(), parts, ranks())


def average_over_ranks(tensors: Sequence[Tensor]) -> None:
    """Replace each tensor by its mean over the ranks, in one message."""
    if ranks() == 1:
        return
    flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
    dist.all_reduce(flat)
    parts = (flat / ranks()).split([tensor.numel() for tensor in tensors])
    for tensor, part in zip(tensors, parts, strict=True):
        tensor.copy_(part.view_as(tensor))
