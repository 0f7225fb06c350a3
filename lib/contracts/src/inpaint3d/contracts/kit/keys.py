"""The key of a stage run: everything that its result depends on, and nothing else.

The instruction set is in it, since compiled code rounds as its vectors are wide. Not in it: resources, retries,
threads, absolute paths. Two tiers (key -> outputs -> objects) give early cut-off: inputs are *content* digests, so
that an upstream rerun that produces identical bytes reruns nothing.
"""

import platform
from functools import cache
from pathlib import Path
from typing import Any

from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.stage import StageSpec

ALGORITHM = "1"
_AVX2 = {"avx2", "fma"}
_AVX512 = {"avx512f", "avx512dq", "avx512vl", "avx512bw", "fma"}
VECTORS = {"amx": {"amx_bf16", *_AVX512}, "avx512": _AVX512, "avx2": _AVX2}
"""Name -> the processor's flags that it needs; the first that fits is used."""

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
    return components | ({"stub": True} if stub else {"instruction_set": find_instruction_set()})


@cache
def find_instruction_set() -> str:
    """What numeric code of this machine is compiled for, as far as results depend on it.

    The architecture, and on x86 the widest vectors that kernels and torch choose between at run time.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    flags = next((line for line in lines if line.startswith("flags")), "").partition(":")[2].split()
    return "-".join(part for part in (platform.machine(), name_widest_vectors(set(flags))) if part)


def name_widest_vectors(flags: set[str]) -> str:
    """The first of VECTORS that a processor with these flags has; empty for none."""
    return next((name for name, needed in VECTORS.items() if needed <= flags), "")


def run_key(components: dict[str, Any]) -> Digest:
    return digest_of(components)
