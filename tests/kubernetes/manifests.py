"""The manifests that the tests look at. `python -m tests.kubernetes.manifests` writes the golden ones."""

from pathlib import Path
from typing import Any

from inpaint3d.contracts.models.cluster import ClusterSpec, Image, Scene, Submission
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.emit.argo import RECORDER, emit
from inpaint3d.orchestrator.emit.documents import dump

HERE = Path(__file__).parent
TOY = Pipeline(HERE / "toy" / "pipeline.yaml")
DIGEST = "sha256:" + "c" * 64


def cluster(**spec: Any) -> ClusterSpec:
    document = {"apiVersion": "inpaint3d/v1", "kind": "Cluster", "metadata": {"name": "test"}}
    return ClusterSpec.model_validate({**document, "spec": {"store": "s3://artifacts/inpaint3d", **spec}})


def submission(pipeline: Pipeline, **options: Any) -> Submission:
    """Two scenes, one of them called as YAML calls a boolean."""
    names = [RECORDER, *(s.spec.image for s in pipeline.stages.values())]
    images = {
        n: Image(image=f"registry.example/{n}:1", digest="sha256:" + "ab"[i % 2] * 64) for i, n in enumerate(names)
    }
    scenes = tuple(Scene(name=n, externals={"capture": DIGEST}) for n in ("kitchen", "n"))
    return Submission(**{"name": "test", "preset": None, "images": images, "scenes": scenes, **options})


def golden() -> dict[str, str]:
    """File name -> manifests."""
    plain = cluster(credentialsSecret="inpaint3d-s3", endpoint="https://s3.example", scenesPerWorkflow=1)
    rich = cluster(
        cache={"claimName": "cache"},
        priorityClassName="batch",
        nodeSelector={"pool": "inpaint3d"},
        gpu={"nodeSelector": {"accelerator": "n"}},
        tolerations=[{"key": "batch", "operator": "Exists"}],
    )
    return {
        "cpu.yaml": dump(emit(TOY, plain, submission(TOY))),
        "cuda-await-masks.yaml": dump(emit(TOY, rich, submission(TOY, device="cuda", awaitMasks=True, seed=7))),
    }


if __name__ == "__main__":
    for file, text in golden().items():
        (HERE / "golden" / file).write_text(text)
