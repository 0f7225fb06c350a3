"""What enters the pipeline from outside: folders, a mask request, networks, taken into the store as artifacts."""

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


class Segmenter(Closed):
    """A network that finds what is pointed at on a picture, of the Segment Anything family, as two ONNX files.

    Weights that lie beside them in files of their own (ONNX's external data) lie there under their own names.
    """

    family: Literal["sam", "sam2", "efficient-sam"] = Field(
        description="what it is asked as, told from its files' inputs and outputs; MobileSAM is asked as sam"
    )
    encoder: RelativePath = Field(default="encoder/network.onnx", description="picture -> embedding")
    decoder: RelativePath = Field(default="decoder/network.onnx", description="embedding and points -> masks, scores")
