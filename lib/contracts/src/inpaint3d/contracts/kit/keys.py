"""The key of a stage run: everything that its result depends on, and nothing else.

Not in it: resources, retries, threads, absolute paths. Two tiers (key -> outputs -> objects) give early
cut-off: inputs are *content* digests, so that an upstream rerun that produces identical bytes reruns nothing.
"""

from typing import Any

from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.stage import StageSpec

ALGORITHM = "1"

Inputs = dict[str, Digest | list[Digest]]


def key_components(
    spec: StageSpec,
    *,
    code: Digest,
    parameters: dict[str, Any],
    inputs: Inputs,
    seed: int,
    device: str,
    stub: bool = False,
) -> dict[str, Any]:
    """What the key is taken over, by name, so that a difference can be explained."""
    components: dict[str, Any] = {
        "algorithm": ALGORITHM,
        "stage": spec.id,
        "code": code,
        "parameters": parameters,
        "inputs": inputs,
        "outputs": {name: port.schema_id for name, port in spec.spec.outputs.items()},
        "seed": seed,
        "device": device,
    }
    return components | ({"stub": True} if stub else {})


def run_key(components: dict[str, Any]) -> Digest:
    return digest_of(components)
