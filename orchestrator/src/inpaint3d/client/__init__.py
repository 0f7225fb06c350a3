"""Results of runs as Python objects, without a tensor library: `inpaint3d.client.open("kitchen")`.

    run = inpaint3d.client.open("kitchen")
    run["pose-estimation.posed-capture"].metadata.registration.registered
    run["evaluation"].metadata.protocols[0].metrics

In a notebook a run and an artifact show themselves.
"""

from inpaint3d.client.run import Run, StoredArtifact, open_run

open = open_run  # noqa: A001 - as it is asked for: inpaint3d.client.open

__all__ = ["Run", "StoredArtifact", "open"]
