"""Networks of the Segment Anything family: which one two ONNX files are, and which files belong to them.

Inputs and outputs as the projects' own exporters name them: segment-anything's `export_onnx_model.py` (MobileSAM's is
the same), samexporter for its encoder and for SAM 2, EfficientSAM's `export_to_onnx.py`.
"""

from pathlib import Path, PurePosixPath
from typing import Literal, NamedTuple

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import Segmenter
from inpaint3d.contracts.models.onnx_signature import OnnxSignature, Shape, read_onnx_signature
from inpaint3d.contracts.models.untrusted import UntrustedError

Family = Literal["sam", "sam2", "efficient-sam"]
EMBEDDING = ("image_embed", "high_res_feats_0", "high_res_feats_1")  # of SAM 2
PROMPT = ("point_coords", "point_labels", "mask_input", "has_mask_input")
BATCHED_PROMPT = ("batched_point_coords", "batched_point_labels", "orig_im_size")


class _Decoder(NamedTuple):
    inputs: frozenset[str]
    optional: frozenset[str]
    outputs: tuple[str, ...]
    """One of which holds masks, and the last scores."""


DECODERS: dict[Family, _Decoder] = {
    "sam": _Decoder(
        frozenset({"image_embeddings", *PROMPT, "orig_im_size"}),
        frozenset(),
        ("low_res_masks", "masks", "iou_predictions"),
    ),
    "sam2": _Decoder(frozenset({*EMBEDDING, *PROMPT}), frozenset({"orig_im_size"}), ("masks", "iou_predictions")),
    "efficient-sam": _Decoder(
        frozenset({"image_embeddings", *BATCHED_PROMPT}), frozenset(), ("output_masks", "iou_predictions")
    ),
}
ENCODERS: dict[Family, str] = {
    "sam": "one input, a picture [1, 3, side, side] or [height, width, 3], and one output, its embedding",
    "sam2": f"one input, a picture [1, 3, side, side], and the outputs {', '.join(EMBEDDING)}",
    "efficient-sam": "one input, a picture [1, 3, height, width], and one output, its embedding",
}


def recognise(encoder: Path, decoder: Path) -> tuple[Family, tuple[Path, ...], tuple[Path, ...]]:
    """The family of two ONNX files, and the files that hold more weights of each.

    Raises ConfigurationError, which names the file, what it has and what is wanted.
    """
    first, second = (_read(path) for path in (encoder, decoder))
    family = _find_family(decoder, second)
    if not _fits(family, first):
        raise ConfigurationError(
            f"--segmenter {encoder} is not the encoder of {decoder}, which is a decoder of {family}: it "
            f"{_describe(first)}; wanted: {ENCODERS[family]}"
        )
    return family, _locate_weights(encoder, first), _locate_weights(decoder, second)


def _read(path: Path) -> OnnxSignature:
    try:
        return read_onnx_signature(path)
    except UntrustedError as error:
        raise ConfigurationError(f"--segmenter {path}: {error}; give an encoder and a decoder as ONNX files") from error
    except OSError as error:
        raise ConfigurationError(f"--segmenter {path} cannot be read ({error.strerror}); give an ONNX file") from error


def _find_family(path: Path, found: OnnxSignature) -> Family:
    for family, wanted in DECODERS.items():
        *masks, scores = wanted.outputs
        named = wanted.inputs <= found.inputs.keys() <= wanted.inputs | wanted.optional
        if named and scores in found.outputs and any(name in found.outputs for name in masks):
            return family
    known = "; ".join(f"{f} takes {', '.join(sorted(w.inputs))}" for f, w in DECODERS.items())
    raise ConfigurationError(
        f"--segmenter {path} is no decoder that can be asked: it {_describe(found)}; wanted, with iou_predictions and "
        f"masks among the outputs: {known}. The encoder is named first, the decoder second"
    )


def _fits(family: Family, encoder: OnnxSignature) -> bool:
    if len(encoder.inputs) != 1:
        return False
    (shape,) = encoder.inputs.values()
    if family == "sam2":
        return _is_planar(shape) and set(EMBEDDING) <= encoder.outputs.keys()
    interleaved = family == "sam" and len(shape) == 3 and shape[2] in (3, None)
    return len(encoder.outputs) == 1 and (_is_planar(shape) or interleaved)


def _is_planar(shape: Shape) -> bool:
    return len(shape) == 4 and shape[1] in (3, None)


def _describe(found: OnnxSignature) -> str:
    def listed(values: dict[str, Shape]) -> str:
        shown = (f"{name} [{', '.join('?' if n is None else str(n) for n in s)}]" for name, s in values.items())
        return ", ".join(shown) or "nothing"

    return f"takes {listed(found.inputs)} and gives {listed(found.outputs)}"[:1000]


def _locate_weights(path: Path, found: OnnxSignature) -> tuple[Path, ...]:
    """The files beside an ONNX file that hold its weights."""
    for name in found.external:
        # It would lie where the network itself does.
        taken = name == PurePosixPath(Segmenter(family="sam").encoder).name
        if taken or "/" in name or "\\" in name or not (path.parent / name).is_file():
            raise ConfigurationError(
                f"--segmenter {path}: its weights are said to lie in {name!r:.200}, which is no file beside it; copy "
                "that file there, or export again into one file"
            )
    return tuple(path.parent / name for name in found.external)
