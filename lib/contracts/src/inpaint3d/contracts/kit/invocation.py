"""What a stage is asked: the file that starts it, however it is started."""

from pathlib import Path
from typing import Any, cast

from pydantic import Field, ValidationError, field_validator

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.manifest import first_error


class Invocation(Closed):
    """What to run: everything that the key is taken over, and what it does not depend on."""

    parameters: dict[str, Any] = {}
    inputs: dict[str, Digest | list[Digest]] = {}
    seed: int = 0
    device: str = "cpu"
    threads: int = Field(default=2, ge=1)
    stub: bool = False
    die_with_parent: bool = False
    accept_doubtful: bool = Field(default=False, description="end well also where the result is doubtful")

    @field_validator("inputs", mode="before")
    @classmethod
    def _drop_absent(cls, inputs: dict[str, Any]) -> dict[str, Any]:
        """A manifest has no way to leave an input out: what an optional output did not give is empty there."""
        present: dict[str, Any] = {}
        for port, given in inputs.items():
            found = [d for d in cast(list[Any], given) if d] if isinstance(given, list) else given
            if found:
                present[port] = found
        return present


def load_invocation(path: Path) -> Invocation:
    """What a file asks; ConfigurationError where it cannot be read or is no invocation."""
    try:
        return Invocation.model_validate_json(path.read_bytes())
    except OSError as error:
        raise ConfigurationError(f"cannot read the invocation {path}: {error.strerror}") from error
    except ValidationError as error:
        raise ConfigurationError(f"{path}: {first_error(error)}") from error
