"""The object on one picture, by a network of the Segment Anything family (arXiv:2304.02643) that a person names.

An encoder is asked once for each picture, a decoder for each set of points; of the masks that it offers the one counts
that it gives the highest predicted IoU, as in the paper.
"""

import threading
from abc import ABC, abstractmethod
from collections import OrderedDict
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import Segmenter
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.colour import to_bytes
from inpaint3d.stages.mask_authoring.network import Array, Network
from inpaint3d.stages.mask_authoring.segment import Prompts

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Size = tuple[int, int]
"""Width and height, pixels."""
Features = dict[str, Array]

PIXEL_MEAN = np.array([123.675, 116.28, 103.53], np.float32)  # red, green, blue from 0 to 255
PIXEL_SPREAD = np.array([58.395, 57.12, 57.375], np.float32)
# What a point is to the decoder.
BESIDE, ON_OBJECT, BOX_LOW, BOX_HIGH, NO_POINT = 0, 1, 2, 3, -1
HALF = 0.5  # decoders count pixels from their centres and add half of one; here corners are whole numbers
SIDE = 1024  # pixels; of the square that all published networks look at
MASKS_COARSER = 4  # than that square
KEPT = 32  # pictures whose embeddings are kept, 4 to 16 MB each


def load_segmenter(artifact: Artifact[Segmenter], threads: int) -> "SegmentAnything":
    """The network of a `segmenter` artifact. BadInputError where onnxruntime cannot run its files."""
    given = artifact.metadata
    encoder, decoder = (Network(artifact.path(path), threads) for path in (given.encoder, given.decoder))
    families = {"sam": Sam, "sam2": Sam2, "efficient-sam": EfficientSam}
    return families[given.family](encoder, decoder)


class SegmentAnything(ABC):
    """Finds what is pointed at on a view; may be asked from several threads."""

    name: ClassVar[str]

    def __init__(self, encoder: Network, decoder: Network) -> None:
        self.encoder, self.decoder = encoder, decoder
        self.side = MASKS_COARSER * (decoder.inputs.get("mask_input", (None,) * 4)[2] or SIDE // MASKS_COARSER)
        self._kept: OrderedDict[str, Features] = OrderedDict()
        self._one_at_a_time = threading.Lock()

    def segment(self, view: View, prompts: Prompts) -> Bools:
        """The object on a view's picture -> bool [h, w], which may be empty. Prompts are in pixels of the picture."""
        picture = (view.camera.width, view.camera.height)
        shown = self.fit(picture)
        xy, labels = list_points(prompts)
        with self._one_at_a_time:
            features = self._embed(view, shown)
            logits, scores = self.ask(features, xy * shown / picture, labels, shown)
        best = self.choose(logits, scores, prompts.background * shown / picture, shown)
        return cv2.resize(logits[best], picture, interpolation=cv2.INTER_LINEAR) > 0

    @abstractmethod
    def fit(self, picture: Size) -> Size:
        """The size that a picture is resampled to for the encoder."""

    @abstractmethod
    def arrange(self, pixels: Array) -> Array:
        """The encoder's input for a picture of that size, float32 [h, w, 3] from 0 to 255."""

    @abstractmethod
    def ask(self, features: Features, xy: Floats, labels: Floats, shown: Size) -> tuple[Array, Array]:
        """Logits [k, h, w] that cover the picture, and predicted IoU [k]; points [n, 2] in pixels of `shown`."""

    def choose(self, logits: Array, scores: Array, background: Floats, shown: Size) -> int:  # noqa: ARG002
        """Which mask counts."""
        return int(np.argmax(scores))

    def _embed(self, view: View, shown: Size) -> Features:
        if view.name not in self._kept:
            pixels = to_bytes(view.image())
            shrinks = shown[0] < pixels.shape[1]
            pixels = cv2.resize(pixels, shown, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
            (taken,) = self.encoder.inputs
            found = self.encoder.run({taken: self.arrange(pixels.astype(np.float32))}, self.encoder.outputs)
            self._kept[view.name] = dict(zip(self.encoder.outputs, found, strict=True))
        self._kept.move_to_end(view.name)
        while len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return self._kept[view.name]

    def _describe_points(self, xy: Floats, labels: Floats, shown: Size) -> Features:
        """The decoder's input but for embeddings, as SAM and SAM 2 have it; no mask is given."""
        coarse = self.side // MASKS_COARSER
        return {
            "point_coords": (xy - HALF)[None],
            "point_labels": labels[None],
            "mask_input": np.zeros((1, 1, coarse, coarse)),
            "has_mask_input": np.zeros(1),
            "orig_im_size": np.array(shown[::-1]),
        }


class Sam(SegmentAnything):
    """Segment Anything and MobileSAM: the picture in the upper left of a square, zeros beside it."""

    name = "Segment Anything"

    def fit(self, picture: Size) -> Size:
        return _fit_longest(picture, self.side)

    def arrange(self, pixels: Array) -> Array:
        ((_, shape),) = self.encoder.inputs.items()
        if len(shape) == 3:  # it prepares pictures itself
            return pixels
        height, width, _ = pixels.shape
        square = np.zeros((self.side, self.side, 3), np.float32)
        square[:height, :width] = (pixels - PIXEL_MEAN) / PIXEL_SPREAD
        return square.transpose(2, 0, 1)[None]

    def ask(self, features: Features, xy: Floats, labels: Floats, shown: Size) -> tuple[Array, Array]:
        if BOX_LOW not in labels:  # so it was trained: points without a box have one more, which is none
            xy, labels = np.concatenate([xy, [[HALF, HALF]]]), np.append(labels, NO_POINT)
        (embedding,) = features.values()
        given = {"image_embeddings": embedding} | self._describe_points(xy, labels, shown)
        coarse = "low_res_masks" in self.decoder.outputs
        logits, scores = self.decoder.run(given, ["low_res_masks" if coarse else "masks", "iou_predictions"])
        # Exported decoders may have the crop of another picture's shape in them, so it is done here where it can be.
        return (self._crop(logits[0], shown) if coarse else logits[0]), scores[0]

    def _crop(self, logits: Array, shown: Size) -> Array:
        large = [cv2.resize(one, (self.side, self.side), interpolation=cv2.INTER_LINEAR) for one in logits]
        return np.stack(large)[:, : shown[1], : shown[0]]


class Sam2(SegmentAnything):
    """Segment Anything 2 (arXiv:2408.00714): the picture stretched to a square."""

    name = "Segment Anything 2"

    def fit(self, picture: Size) -> Size:  # noqa: ARG002 - of any shape
        return self.side, self.side

    def arrange(self, pixels: Array) -> Array:
        return ((pixels - PIXEL_MEAN) / PIXEL_SPREAD).transpose(2, 0, 1)[None]

    def ask(self, features: Features, xy: Floats, labels: Floats, shown: Size) -> tuple[Array, Array]:
        given = features | self._describe_points(xy, labels, shown)
        logits, scores = self.decoder.run(given, ["masks", "iou_predictions"])
        return logits[0], scores[0]


class EfficientSam(SegmentAnything):
    """EfficientSAM (arXiv:2312.00863): the picture as it is; normalised and stretched to a square inside.

    It has no word for a point beside the object: of its masks, those that hold such points come last.
    """

    name = "EfficientSAM"
    most_points: ClassVar[int] = 6
    """The decoder passes over more without a word; a box is two."""

    def fit(self, picture: Size) -> Size:
        return _fit_longest(picture, min(max(picture), self.side))

    def arrange(self, pixels: Array) -> Array:
        return (pixels / 255).transpose(2, 0, 1)[None]

    def ask(self, features: Features, xy: Floats, labels: Floats, shown: Size) -> tuple[Array, Array]:
        xy, labels = xy[labels != BESIDE], labels[labels != BESIDE]
        if len(xy) > self.most_points:
            raise ConfigurationError(
                f"mask request: EfficientSAM takes at most {self.most_points} points on the object, of which a box "
                f"counts two, not {len(xy)}; leave some out, or name another --segmenter"
            )
        (embedding,) = features.values()
        given = {
            "image_embeddings": embedding,
            # Half a pixel of the square that it stretches them to.
            "batched_point_coords": (xy - HALF * np.array(shown) / self.side)[None, None],
            "batched_point_labels": labels[None, None],
            "orig_im_size": np.array(shown[::-1]),
        }
        logits, scores = self.decoder.run(given, ["output_masks", "iou_predictions"])
        return logits[0, 0], scores[0, 0]

    def choose(self, logits: Array, scores: Array, background: Floats, shown: Size) -> int:  # noqa: ARG002
        column, row = background.astype(np.int64).T
        held = (logits[:, row, column] > 0).sum(1)
        return int(np.argmax(np.where(held == held.min(), scores, -np.inf)))


def list_points(prompts: Prompts) -> tuple[Floats, Floats]:
    """What was pointed at as points [n, 2], and what each is [n]; a box is its two corners."""
    corners = np.array(prompts.box or (), np.float64).reshape(-1, 2)
    codes = ((prompts.points, ON_OBJECT), (prompts.background, BESIDE), (corners[:1], BOX_LOW), (corners[1:], BOX_HIGH))
    labels = np.concatenate([np.full(len(points), code, np.float64) for points, code in codes])
    return np.concatenate([points for points, _ in codes]), labels


def _fit_longest(picture: Size, longest: int) -> Size:
    """The size with this longest side."""
    scale = longest / max(picture)
    return int(picture[0] * scale + 0.5), int(picture[1] * scale + 0.5)
