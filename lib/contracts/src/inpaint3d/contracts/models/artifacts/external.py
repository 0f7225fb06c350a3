"""What enters the pipeline from outside: raw folders and a mask request, taken into the store as artifacts."""

from typing import Literal

from pydantic import Field

from inpaint3d.contracts.models.artifacts.masks import MaskRequest
from inpaint3d.contracts.models.base import Closed, FrameName, RelativePath


class Source(Closed):
    """A folder or file as the user has it, byte for byte, under `raw/` with its own relative paths."""

    name: str = Field(description="the folder's name; the default name of a run")
    kind: Literal["folder", "file"]


class MaskRequestArtifact(Closed):
    """A mask request (the user's YAML), parsed and validated; images that it names lie under `images/`."""

    request: MaskRequest


class ImageCorpus(Closed):
    """Pictures to train a prior on, under `images/`. The split is by scene, never by frame (D1)."""

    class Picture(Closed):
        name: FrameName
        path: RelativePath
        scene: str
        split: Literal["train", "test"]

    pictures: tuple[Picture, ...]


class DiffusersPipeline(Closed):
    """Somebody else's inpainting model: a pipeline as the diffusers library saves it, under `pipeline/`."""

    kind: str = Field(description="the pipeline's class, as its model_index.json names it")
