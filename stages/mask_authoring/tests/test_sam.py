"""Networks of the Segment Anything family: tiny ones with the inputs and outputs of the real ones, of known answers."""

from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.artifacts import Segmenter
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.intake import take_segmenter
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.image_io import read_mask, write_png
from inpaint3d.stages.mask_authoring.sam import SegmentAnything, load_segmenter
from inpaint3d.stages.mask_authoring.segment import Prompts, iou
from tests.mask_bench import FAST, Bench, make_bench, precision, recall
from tests.sam_networks import BESIDE, COLOUR, KINDS, REACH, Kind, write_networks

WIDTH, HEIGHT = 192, 144
NONE = np.zeros((0, 2))


def load(folder: Path, kind: Kind, **how) -> SegmentAnything:
    store = FolderStore(folder / "store")
    digest = take_segmenter(store, *write_networks(folder, kind, **how))
    return load_segmenter(store.open(digest, Segmenter), threads=1)


def photograph(folder: Path, width: int = WIDTH, height: int = HEIGHT) -> tuple[View, np.ndarray]:
    """A view that shows a patch of COLOUR in the middle, on grey, and where it is."""
    patch = np.zeros((height, width), bool)
    patch[height // 4 : 3 * height // 4, width // 4 : 3 * width // 4] = True
    write_png(folder / "a.png", np.where(patch[..., None], COLOUR / 255, 0.4).astype(np.float32))
    camera = Camera(width, width, width / 2, height / 2, width, height, np.eye(4))
    return View("a", camera, "train", None, folder / "a.png"), patch


def reach_of(kind: Kind, share: float, width: int, height: int) -> tuple[float, float]:
    """A share of the network's square in pixels of the picture, across and down."""
    stretched = kind in ("sam2", "efficient-sam")
    return share * (width if stretched else max(width, height)), share * (height if stretched else max(width, height))


@pytest.mark.parametrize(("width", "height"), [(192, 144), (144, 192), (40, 30)])
@pytest.mark.parametrize("kind", KINDS)
def test_the_mask_is_round_the_point_to_a_pixel(tmp_path, kind: Kind, width: int, height: int) -> None:
    # Half a pixel of the network's is more than one of the large pictures: which corner pixels count from is seen.
    view, _ = photograph(tmp_path, width, height)
    x, y = 0.52 * width + 0.1, 0.46 * height + 0.3
    found = load(tmp_path, kind).segment(view, Prompts(np.array([[x, y]]), NONE))
    across, down = reach_of(kind, REACH, width, height)
    columns, rows = np.arange(width) + 0.5, np.arange(height) + 0.5
    np.testing.assert_array_equal(found[int(y)], np.abs(columns - x) < across)
    np.testing.assert_array_equal(found[:, int(x)], np.abs(rows - y) < down)


@pytest.mark.parametrize("kind", KINDS)
def test_colours_are_normalised_as_the_network_learnt_them(tmp_path, kind: Kind) -> None:
    view, patch = photograph(tmp_path)
    nearly_all = Prompts(NONE, NONE, (8.0, 6.0, 184.0, 138.0))
    assert iou(load(tmp_path, kind, tolerance=0.1).segment(view, nearly_all), patch) > 0.9
    assert load(tmp_path / "all", kind).segment(view, nearly_all).sum() > 2 * patch.sum()


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "efficient-sam"])
def test_a_background_point_takes_away_what_is_round_it(tmp_path, kind: Kind) -> None:
    view, _ = photograph(tmp_path)
    segmenter = load(tmp_path, kind)
    points, beside = np.array([[96.0, 72.0]]), np.array([[132.0, 72.0]])
    plain, less = (segmenter.segment(view, Prompts(points, background)) for background in (NONE, beside))
    away = np.abs(np.arange(WIDTH) + 0.5 - 132) < reach_of(kind, BESIDE, WIDTH, HEIGHT)[0]
    np.testing.assert_array_equal(less[72], plain[72] & ~away)


@pytest.mark.parametrize("kind", KINDS)
def test_a_box_bounds_the_object_with_points_and_alone(tmp_path, kind: Kind) -> None:
    view, _ = photograph(tmp_path)
    segmenter = load(tmp_path, kind)
    box = (90.0, 60.0, 126.0, 96.0)
    columns = np.arange(WIDTH) + 0.5
    alone = segmenter.segment(view, Prompts(NONE, NONE, box))
    np.testing.assert_array_equal(alone[78], (columns > 90) & (columns < 126))
    both = segmenter.segment(view, Prompts(np.array([[96.0, 78.0]]), NONE, box))
    reach = reach_of(kind, REACH, WIDTH, HEIGHT)[0]
    np.testing.assert_array_equal(both[78], (columns > 90) & (columns < 96 + reach))


@pytest.mark.parametrize("best", [0, 2])
@pytest.mark.parametrize("kind", ["sam", "sam2", "efficient-sam"])
def test_the_mask_of_the_highest_score_counts(tmp_path, kind: Kind, best: int) -> None:
    view, _ = photograph(tmp_path)
    found = load(tmp_path, kind, best=best).segment(view, Prompts(np.array([[96.0, 72.0]]), NONE))
    assert found[72, 96]
    assert not found[4, 4]


def test_efficient_sam_prefers_masks_without_the_background_points(tmp_path) -> None:
    view, _ = photograph(tmp_path)
    prompts = Prompts(np.array([[96.0, 72.0]]), np.array([[100.0, 72.0]]))
    found = load(tmp_path, "efficient-sam").segment(view, prompts)
    assert not found[72, 100], "the mask of the highest score holds it, the others do not"
    with pytest.raises(ConfigurationError, match=r"EfficientSAM takes at most 6 points .* not 7"):
        load(tmp_path, "efficient-sam").segment(view, Prompts(np.full((5, 2), 50.0), NONE, (1, 1, 90, 90)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_picture_is_embedded_once(tmp_path, kind: Kind) -> None:
    view, _ = photograph(tmp_path)
    segmenter = load(tmp_path, kind)
    first = segmenter.segment(view, Prompts(np.array([[96.0, 72.0]]), NONE))
    view.image_path.unlink()  # it is not looked at again
    np.testing.assert_array_equal(segmenter.segment(view, Prompts(np.array([[96.0, 72.0]]), NONE)), first)


def test_what_onnxruntime_cannot_run_is_told_by_file(tmp_path) -> None:
    store = FolderStore(tmp_path / "store")
    encoder, decoder = write_networks(tmp_path, "sam")
    encoder.write_bytes(encoder.read_bytes().replace(b"AveragePool", b"AveragePoo1"))
    network = store.open(take_segmenter(store, encoder, decoder), Segmenter)
    with pytest.raises(BadInputError, match=r"network\.onnx cannot be run by onnxruntime .*AveragePoo1"):
        load_segmenter(network, threads=1)


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("store"))


def test_the_stage_asks_the_network_where_it_is_pointed_at_and_carries_the_answer(bench, tmp_path) -> None:
    segmenter = take_segmenter(bench.store, *write_networks(tmp_path, "sam2"))
    rows, columns = np.nonzero(bench.scene.object_masks[2])
    around = [columns.min() - 1, rows.min() - 1, columns.max() + 2, rows.max() + 2]
    request = {"kind": "object", "view": "view_002", "box": [float(v) for v in around]}
    unrefined = FAST.model_copy(update={"refine": False})
    asked, root = bench.author(request, config=unrefined, segmenter=segmenter)
    assert asked.method.startswith("Segment Anything 2 asked by a box in view_002, reprojected")
    plain, _ = bench.author(request, config=unrefined)
    assert plain.method.startswith("GrabCut on colour and depth seeded by a box in view_002, reprojected")
    assert asked.views[2].share > 1.05 * plain.views[2].share, "this network takes all of the box"
    masks = [read_mask(root / view.mask) for view in asked.views]
    assert recall(masks, bench.scene.object_masks)[1:4].min() > 0.9
    assert precision(masks, bench.scene.object_masks)[1:4].min() > 0.5
