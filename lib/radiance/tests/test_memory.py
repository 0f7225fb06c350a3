import gc

import torch

from inpaint3d.radiance.memory import GradientMemory, allocate_like


def test_memory_is_used_again_only_when_nothing_refers_to_it() -> None:
    memory, table = GradientMemory(), torch.zeros(5, 2)
    first, second = memory.take(table), memory.take(table)
    assert first.shape == (5, 2)
    assert first.data_ptr() != second.data_ptr()
    place, part = first.data_ptr(), first[2:].detach()
    del first
    assert memory.take(table).data_ptr() != place  # a part of it lives
    del part
    assert memory.take(table).data_ptr() == place


def test_another_table_has_other_memory_and_a_dead_table_none() -> None:
    memory, one, other = GradientMemory(), torch.zeros(3), torch.zeros(3)
    place = memory.take(one).data_ptr()
    assert memory.take(other).data_ptr() != place
    del one
    gc.collect()
    assert len(memory._arrays) == 1  # pyright: ignore[reportPrivateUsage]


def test_an_optimizer_keeps_the_gradient_that_it_was_given() -> None:
    memory, table = GradientMemory(), torch.zeros(4, requires_grad=True)
    table.grad = memory.take(table).fill_(7)
    memory.take(table).fill_(1)
    assert table.grad is not None
    assert (table.grad == 7).all()


def test_roomy_memory_has_the_shape_and_kind_of_a_tensor() -> None:
    for like in (torch.zeros(3, 2), torch.zeros(0, 4), torch.zeros(2).double()):
        made = allocate_like(like)
        assert (made.shape, made.dtype, made.device) == (like.shape, like.dtype, like.device)
