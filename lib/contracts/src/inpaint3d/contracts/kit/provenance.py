"""Where a result comes from, in the form that supply-chain tools read."""

import datetime
from typing import Any

from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.stage import StageSpec


def describe_provenance(
    spec: StageSpec,
    key: Digest,
    components: dict[str, Any],
    produced: dict[str, Digest],
    started: datetime.datetime,
) -> dict[str, Any]:
    """An in-toto statement with the SLSA v1 provenance predicate."""
    flat = [(port, d) for port, ds in components["inputs"].items() for d in ([ds] if isinstance(ds, str) else ds)]
    return {
        "_type": "https://in-toto.io/Statement/v1",
        "subject": [{"name": port, "digest": _describe_digest(d)} for port, d in produced.items()],
        "predicateType": "https://slsa.dev/provenance/v1",
        "predicate": {
            "buildDefinition": {
                "buildType": f"urn:inpaint3d:stage:{spec.id}",
                "externalParameters": components["parameters"],
                "internalParameters": {"seed": components["seed"], "device": components["device"]},
                "resolvedDependencies": [
                    {"name": "code", "digest": _describe_digest(components["code"])},
                    *({"name": port, "digest": _describe_digest(d)} for port, d in flat),
                ],
            },
            "runDetails": {
                "builder": {"id": spec.spec.image},
                "metadata": {
                    "invocationId": key,
                    "startedOn": started.isoformat(),
                    "finishedOn": datetime.datetime.now(datetime.UTC).isoformat(),
                },
            },
        },
    }


def _describe_digest(digest: Digest) -> dict[str, str]:
    return {"sha256": digest.removeprefix("sha256:")}
