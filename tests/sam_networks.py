"""Tiny networks with the inputs and outputs of the Segment Anything family, whose answers are known.

Embeddings are the picture's normalised colours on 16 x 16 cells. The right mask is what has the colour COLOUR, lies
within REACH of a point on the object (in both directions), farther than BESIDE from every background point, and inside
the box; all in pixels of the square that the network looks at. The other two masks are its opposite.
"""

from pathlib import Path
from typing import Literal

import numpy as np
import onnx
import onnx.parser
from onnx import numpy_helper

CELLS = 16
MEAN, SPREAD = np.array([123.675, 116.28, 103.53]), np.array([58.395, 57.12, 57.375])
COLOUR = np.array([200.0, 60.0, 40.0])  # red, green, blue
REACH, BESIDE = 0.125, 0.09375  # of the square's side
FAR = 1e4

Kind = Literal["sam", "sam-interleaved", "sam-masks", "sam2", "efficient-sam"]
KINDS: tuple[Kind, ...] = ("sam", "sam-interleaved", "sam-masks", "sam2", "efficient-sam")
"""`sam-interleaved`: its encoder prepares pictures itself (MobileSAM's usual export). `sam-masks`: its decoder gives no
`low_res_masks`."""
SIDE = {kind: 1024 if kind == "efficient-sam" else 64 for kind in KINDS}

ENCODERS = {
    "sam": "encoder (float[1,3,64,64] input_image) => (float[1,3,16,16] image_embeddings) {"
    " image_embeddings = AveragePool<kernel_shape = [4, 4], strides = [4, 4]>(input_image) }",
    "sam-interleaved": "encoder (float[h,w,3] input_image) => (float[1,3,16,16] image_embeddings) {"
    " centred = Sub(input_image, mean) normal = Div(centred, spread) planes = Transpose<perm = [2, 0, 1]>(normal)"
    " shape = Shape(planes) full = Constant<value_ints = [3, 64, 64]>() after = Sub(full, shape)"
    " before = Constant<value_ints = [0, 0, 0]>() pads = Concat<axis = 0>(before, after) square = Pad(planes, pads)"
    " first = Constant<value_ints = [0]>() batch = Unsqueeze(square, first)"
    " image_embeddings = AveragePool<kernel_shape = [4, 4], strides = [4, 4]>(batch) }",
    "sam2": "encoder (float[1,3,64,64] image) => (float[1,1,64,64] high_res_feats_0, float[1,1,32,32] high_res_feats_1,"
    " float[1,3,16,16] image_embed) { none = Constant<value = float {0}>() halves = Constant<value_floats ="
    " [1.0, 1.0, 0.5, 0.5]>() once = Constant<value_ints = [1]>() two = Constant<value_ints = [1, 2]>()"
    " start = Constant<value_ints = [0]>() one = Slice(image, start, once, once) high_res_feats_0 = Mul(one, none)"
    ' high_res_feats_1 = Resize(high_res_feats_0, "", halves)'
    " image_embed = AveragePool<kernel_shape = [4, 4], strides = [4, 4]>(image) }",
    "efficient-sam": "encoder (float[b,3,h,w] batched_images) => (float[b,3,16,16] image_embeddings) {"
    " cells = Constant<value_ints = [1, 3, 16, 16]>()"
    ' small = Resize<mode = "linear">(batched_images, "", "", cells)'
    " full = Constant<value = float {255}>() bytes = Mul(small, full)"
    " centred = Sub(bytes, mean_planes) image_embeddings = Div(centred, spread_planes) }",
}
PROMPT = "float[1,n,2] point_coords, float[1,n] point_labels, float[1,1,16,16] mask_input, float[1] has_mask_input"
# coords, labels and embedding -> low [1, 3, 16, 16] and scores [1, 3]
DECIDE = """
  half = Constant<value = float {0.5}>() far = Constant<value = float {1e4}>() minus = Constant<value = float {-1e4}>()
  given = Add(coords, half)
  last = Constant<value_ints = [-1]>() second = Constant<value_ints = [2]>() first = Constant<value_ints = [1]>()
  code = Unsqueeze(labels, last)
  on_code = Constant<value = float {1}>() off_code = Constant<value = float {0}>()
  low_code = Constant<value = float {2}>() high_code = Constant<value = float {3}>()
  no_code = Constant<value = float {-1}>()
  is_on = Equal(code, on_code) is_off = Equal(code, off_code) is_low = Equal(code, low_code)
  is_high = Equal(code, high_code) is_no = Equal(code, no_code)
  places = Unsqueeze(given, second)
  offset = Sub(places, grid) apart = Abs(offset) distance = ReduceMax<keepdims = 0>(apart, last)
  to_on = Where(is_on, distance, far) near_on = ReduceMin<keepdims = 0>(to_on, first) within = Sub(reach, near_on)
  some_on = Cast<to = 1>(is_on) count_on = ReduceSum<keepdims = 0>(some_on, first) with_on = Greater(count_on, off_code)
  points_say = Where(with_on, within, far)
  to_off = Where(is_off, distance, far) near_off = ReduceMin<keepdims = 0>(to_off, first) beyond = Sub(near_off, beside)
  low_at = Where(is_low, given, minus) low_corner = ReduceMax<keepdims = 1>(low_at, first)
  high_at = Where(is_high, given, far) high_corner = ReduceMin<keepdims = 1>(high_at, first)
  cells = Squeeze(grid, first)
  from_low = Sub(cells, low_corner) to_high = Sub(high_corner, cells) in_box = Min(from_low, to_high)
  box_says = ReduceMin<keepdims = 0>(in_box, last)
  flat = Reshape(embedding, as_list) unlike = Sub(flat, colour) difference = Abs(unlike)
  worst = ReduceMax<keepdims = 0>(difference, first) alike = Sub(tolerance, worst) sign = Sign(alike)
  colour_says = Mul(sign, cell)
  no_point = Cast<to = 1>(is_no) count_no = ReduceSum<keepdims = 0>(no_point, first)
  box_point = Cast<to = 1>(is_low) count_box = ReduceSum<keepdims = 0>(box_point, first)
  ends = Add(count_no, count_box) surplus = Sub(ends, wanted_ends) wrong = Abs(surplus) penalty = Mul(wrong, minus)
  said = Min(points_say, beyond, box_says, colour_says) judged = Add(said, penalty)
  right = Reshape(judged, as_map) low = Mul(right, signs)
"""
DECODERS = {
    "sam": f"decoder (float[1,3,16,16] image_embeddings, {PROMPT}, float[2] orig_im_size) => (float[1,3,a,b] masks,"
    " float[1,3] iou_predictions, float[1,3,16,16] low_res_masks) {"
    " coords = Identity(point_coords) labels = Identity(point_labels) embedding = Identity(image_embeddings)"
    f" {DECIDE} low_res_masks = Identity(low) masks = Neg(low) iou_predictions = Identity(scores)"
    " unused = Identity(mask_input) also = Identity(has_mask_input) more = Identity(orig_im_size) }",
    "sam-masks": f"decoder (float[1,3,16,16] image_embeddings, {PROMPT}, float[2] orig_im_size) =>"
    " (float[1,3,a,b] masks, float[1,3] iou_predictions) {"
    " coords = Identity(point_coords) labels = Identity(point_labels) embedding = Identity(image_embeddings)"
    f" {DECIDE} iou_predictions = Identity(scores) size = Cast<to = 7>(orig_im_size)"
    " four = Constant<value_ints = [4]>() start = Constant<value_ints = [0, 0]>()"
    " axes = Constant<value_ints = [2, 3]>() coarse = Div(size, four) cropped = Slice(low, start, coarse, axes)"
    " two = Constant<value_ints = [1, 3]>() full = Concat<axis = 0>(two, size)"
    ' masks = Resize<mode = "linear">(cropped, "", "", full)'
    " unused = Identity(mask_input) also = Identity(has_mask_input) }",
    "sam2": "decoder (float[1,3,16,16] image_embed, float[1,1,64,64] high_res_feats_0,"
    f" float[1,1,32,32] high_res_feats_1, {PROMPT}) => (float[1,3,16,16] masks, float[1,3] iou_predictions) {{"
    " coords = Identity(point_coords) labels = Identity(point_labels) embedding = Identity(image_embed)"
    f" {DECIDE} masks = Identity(low) iou_predictions = Identity(scores) unused = Identity(mask_input)"
    " also = Identity(has_mask_input) more = Identity(high_res_feats_0) most = Identity(high_res_feats_1) }",
    "efficient-sam": "decoder (float[b,3,16,16] image_embeddings, float[1,q,n,2] batched_point_coords,"
    " float[1,q,n] batched_point_labels, int64[2] orig_im_size) =>"
    " (float[1,q,3,a,b] output_masks, float[1,q,3] iou_predictions) {"
    " query = Constant<value_ints = [1]>() points = Squeeze(batched_point_coords, query)"
    " labels = Squeeze(batched_point_labels, query) embedding = Identity(image_embeddings)"
    " height_width = Cast<to = 1>(orig_im_size) turned = Constant<value_ints = [1, 0]>()"
    " width_height = Gather(height_width, turned) full_side = Constant<value = float {1024}>()"
    " stretch = Div(full_side, width_height) coords = Mul(points, stretch)"
    f" {DECIDE} two = Constant<value_ints = [1, 3]>() full = Concat<axis = 0>(two, orig_im_size)"
    ' upright = Resize<mode = "linear">(low, "", "", full) output_masks = Unsqueeze(upright, first)'
    " iou_predictions = Unsqueeze(scores, first) }",
}


def write_networks(folder: Path, kind: Kind = "sam", *, best: int = 1, tolerance: float = FAR) -> tuple[Path, Path]:
    """Encoder and decoder. best: which of three masks is right, and has the highest score.

    tolerance: how far a colour may be from COLOUR, in normalised units; by default every colour is taken.
    """
    folder.mkdir(parents=True, exist_ok=True)
    encoder, decoder = folder / f"{kind}.encoder.onnx", folder / f"{kind}.decoder.onnx"
    parts = {"mean": MEAN, "spread": SPREAD, "mean_planes": MEAN[:, None, None], "spread_planes": SPREAD[:, None, None]}
    _write(encoder, ENCODERS.get(kind, ENCODERS["sam"]), parts)
    side = SIDE[kind]
    centres = (np.arange(CELLS) + 0.5) * side / CELLS
    scores = np.full(3, 0.3)
    scores[best] = 0.7
    parts = {
        "grid": np.stack(np.meshgrid(centres, centres), -1).reshape(1, 1, -1, 2),
        "cell": np.array(side / CELLS),
        "reach": np.array(REACH * side),
        "beside": np.array(BESIDE * side),
        "colour": ((COLOUR - MEAN) / SPREAD).reshape(1, 3, 1),
        "tolerance": np.array(tolerance),
        "wanted_ends": np.array(1.0),  # SAM is given one point that is none, or a box
        "signs": np.where(np.arange(3) == best, 1.0, -1.0).reshape(1, 3, 1, 1),
        "scores": scores[None],
    }
    numbers = {"as_list": np.array([1, 3, -1]), "as_map": np.array([1, 1, CELLS, CELLS])}
    text = DECODERS.get(kind, DECODERS["sam"])
    if kind in ("sam2", "efficient-sam"):  # points that are none are added by their decoders, and not given
        text = text.replace("surplus = Sub(ends, wanted_ends)", "surplus = Identity(count_no)")
    _write(decoder, text, parts, numbers)
    return encoder, decoder


def _write(path: Path, text: str, parts: dict, numbers: dict | None = None) -> None:
    model = onnx.parser.parse_model(f'<ir_version: 9, opset_import: ["": 18]> {text}')
    used = {name for node in model.graph.node for name in node.input}
    arrays = {n: a.astype(np.float32) for n, a in parts.items()} | {
        n: a.astype(np.int64) for n, a in (numbers or {}).items()
    }
    model.graph.initializer.extend(numpy_helper.from_array(a, n) for n, a in arrays.items() if n in used)
    onnx.checker.check_model(model)
    onnx.save(model, path)
