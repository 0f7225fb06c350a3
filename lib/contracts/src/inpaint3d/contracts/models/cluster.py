"""`cluster.yaml`, `images.yaml`, and what is asked of a cluster. Kubernetes in form; no secret can stand in them.

Field names in mixed case are Kubernetes' own.
"""
# ruff: noqa: N815

from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints

from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.stage import Name, Quantity

SceneName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]


class Cache(Closed):
    """Where a pod keeps artifacts and checkpoints while it works: its own disk, or a claim that outlives it."""

    sizeLimit: Quantity | None = "20Gi"
    claimName: Name | None = Field(default=None, description="a PersistentVolumeClaim; sizeLimit is then its own")


class Gpu(Closed):
    """How a stage that can use a GPU gets one (`--device cuda`)."""

    resource: str = "nvidia.com/gpu"
    count: Annotated[int, Field(ge=1)] = 1
    nodeSelector: dict[str, str] = {}


class ClusterBody(Closed):
    namespace: Name = "inpaint3d"
    store: Annotated[str, StringConstraints(pattern=r"^s3://[^@?]+$")] = Field(description="s3://BUCKET/PREFIX")
    endpoint: Annotated[str, StringConstraints(pattern=r"^https?://[^@?]+$")] | None = Field(
        default=None, description="the S3 server, where it is not AWS"
    )
    region: str = "us-east-1"
    credentialsSecret: Name | None = Field(
        default=None,
        description="Secret with AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY; none where pods have a role",
    )
    serviceAccountName: Name = "inpaint3d"
    createServiceAccount: bool = Field(
        default=True,
        description="write the service account, and a role that lets its pods report to Argo; false: they are there",
    )
    imagePullPolicy: Literal["Always", "IfNotPresent", "Never"] = "IfNotPresent"
    priorityClassName: Name | None = None
    nodeSelector: dict[str, str] = {}
    tolerations: tuple[dict[str, Any], ...] = ()
    gpu: Gpu = Gpu()
    cache: Cache = Cache()
    largestCpuRequest: Quantity = Field(
        default="1500m", description="no pod asks for more: two cores of a node are less what the node itself needs"
    )
    secondsKept: Annotated[int, Field(ge=0)] = Field(
        default=7 * 24 * 3600, description="how long a Workflow that has ended stays, with its failed pods"
    )
    retries: Annotated[int, Field(ge=0)] = Field(default=3, description="of a pod that was lost")
    parallelism: Annotated[int, Field(ge=1)] = Field(default=50, description="pods of one Workflow at a time")
    scenesPerWorkflow: Annotated[int, Field(ge=1)] = 20


class ClusterMetadata(Closed):
    name: Name


class ClusterSpec(Closed):
    """The whole of `cluster.yaml`: where the pipeline runs and where its artifacts lie."""

    apiVersion: Literal["inpaint3d/v1"]
    kind: Literal["Cluster"]
    metadata: ClusterMetadata
    spec: ClusterBody


class Image(Closed):
    """One built image: what a cluster pulls, and the digest that stands for its code in keys."""

    image: str = Field(description="a reference that the cluster can pull")
    digest: Digest


class ImagesSpec(Closed):
    """The whole of `images.yaml`, which `make images` writes: an image for each name in the `stage.yaml` files."""

    apiVersion: Literal["inpaint3d/v1"]
    kind: Literal["Images"]
    spec: dict[str, Image]


class Scene(Closed):
    """One scene, its externals already in the store."""

    name: SceneName
    externals: dict[Name, Digest]


class Submission(Closed):
    """A set of scenes to be run alike."""

    name: Name
    preset: str | None
    overrides: dict[str, dict[str, Any]] = {}
    compare: bool = Field(default=False, description="also what the result is compared with")
    want: tuple[str, ...] = Field(default=(), description="nodes that are wanted besides the pipeline's own")
    seed: int = 0
    device: Literal["cpu", "cuda"] = "cpu"
    stub: bool = False
    awaitMasks: bool = Field(
        default=False, description="stop before mask-authoring until somebody supplies a mask request"
    )
    acceptDoubtful: bool = Field(default=False, description="go on where a result cannot be right")
    awaitPaintings: bool = Field(
        default=False, description="stop before view-completion until somebody supplies painted views"
    )
    images: dict[str, Image]
    scenes: tuple[Scene, ...]

    @property
    def awaited(self) -> tuple[str, ...]:
        """The externals that somebody supplies while the scene waits."""
        asked = {"mask-request": self.awaitMasks, "painted-views": self.awaitPaintings}
        return tuple(external for external, waits in asked.items() if waits)
