"""Weights of a field on disk (safetensors)."""

from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from inpaint3d.contracts.errors import ArtifactError
from inpaint3d.contracts.models.artifacts import FieldSpec
from inpaint3d.contracts.models.untrusted import UntrustedError, read_safetensors_header
from inpaint3d.radiance import backends
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.health import check_finite, find_non_finite


def save_field(path: Path, field: RadianceField) -> None:
    """Write the weights; equal weights give equal bytes. NonFiniteError where one is not finite."""
    check_finite(field)
    save_file({name: tensor.detach().cpu().contiguous() for name, tensor in field.state_dict().items()}, path)


def load_field(path: Path, spec: FieldSpec, backend: backends.Name | None = None) -> RadianceField:
    """The field of a spec with the weights of a file; ArtifactError where they do not fit."""
    field = RadianceField(spec, seed=0, backend=backend)
    try:
        read_safetensors_header(path)
        weights = load_file(path)
    except (OSError, SafetensorError, UntrustedError) as error:
        raise ArtifactError(f"weights {path} cannot be read ({error}); run the stage that wrote them again") from error
    wanted = {name: tuple(tensor.shape) for name, tensor in field.state_dict().items()}
    found = {name: tuple(tensor.shape) for name, tensor in weights.items()}
    if wanted != found:
        differ = sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))
        raise ArtifactError(f"weights {path} do not fit their spec: {', '.join(differ)} differ; run the stage again")
    if broken := find_non_finite(weights):
        raise ArtifactError(f"weights {path} are not finite: {', '.join(map(str, broken))}; run the stage again")
    field.load_state_dict(weights)
    return field
