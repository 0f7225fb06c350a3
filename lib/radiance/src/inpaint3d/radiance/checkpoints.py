"""The whole state of a training run in one file, so that a killed run goes on as if nothing had happened."""

from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.contracts.kit.checkpoints import OPEN_SEAL, find_checkpoint, write_checkpoint
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.health import check_finite
from inpaint3d.radiance.optim import Adam


def save_checkpoint(
    path: Path,
    field: RadianceField,
    optimizer: Adam,
    generator: torch.Generator,
    extra: dict[str, Tensor] | None = None,
) -> None:
    """Write weights, Adam's moments and step, the generator's state and `extra` tensors; whole or not at all.

    NonFiniteError where one of them is not finite: the checkpoint that is there stays.
    """
    check_finite(field, optimizer)
    state = {f"extra.{name}": tensor for name, tensor in (extra or {}).items()}
    state["generator"] = generator.get_state()
    state["steps"], state["halvings"] = torch.tensor(optimizer.steps), torch.tensor(optimizer.halvings)
    state |= {f"field.{name}": buffer for name, buffer in field.named_buffers()}
    for name, parameter in field.named_parameters():
        m, v = optimizer.moments(parameter)
        state |= {f"field.{name}": parameter.detach(), f"m.{name}": m, f"v.{name}": v}
    tensors = {name: tensor.cpu().contiguous() for name, tensor in state.items()}
    write_checkpoint(path, lambda staged: save_file(tensors, staged, metadata=OPEN_SEAL))


def load_checkpoint(
    path: Path, field: RadianceField, optimizer: Adam, generator: torch.Generator
) -> dict[str, Tensor] | None:
    """Put everything back and return the `extra` tensors; None where there is no whole checkpoint."""
    found = find_checkpoint(path)
    if found is None:
        return None
    state = load_file(found)
    generator.set_state(state["generator"])
    optimizer.steps, optimizer.halvings = int(state["steps"]), int(state["halvings"])
    with torch.no_grad():
        for name, buffer in field.named_buffers():
            buffer.copy_(state[f"field.{name}"])
        for name, parameter in field.named_parameters():
            m, v = optimizer.moments(parameter)
            parameter.copy_(state[f"field.{name}"])
            m.copy_(state[f"m.{name}"])
            v.copy_(state[f"v.{name}"])
    return {name.removeprefix("extra."): t for name, t in state.items() if name.startswith("extra.")}


def go_back(
    path: Path,
    field: RadianceField,
    optimizer: Adam,
    generator: torch.Generator,
    error: NonFiniteError,
    rollbacks: int,
) -> dict[str, Tensor]:
    """After an error: everything as in the last checkpoint, but the steps from there on half as large as before.

    Returns the `extra` tensors. Raises the error, saying what is kept, where the fit went back `rollbacks` times
    already, or has no checkpoint.
    """
    halvings = optimizer.halvings + 1
    kept = load_checkpoint(path, field, optimizer, generator) if halvings <= rollbacks else None
    if kept is None:
        sound = f"the last good checkpoint is kept in {path.parent}" if path.exists() else "there is no checkpoint yet"
        tried = f"; went back {halvings - 1} times before" if halvings > 1 else ""
        raise NonFiniteError(f"{error}{tried}; {sound}") from error
    optimizer.halvings = halvings
    return kept
