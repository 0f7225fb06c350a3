"""The smaller mask: what no other view shows."""

import numpy as np
import pytest

from inpaint3d.contracts.models.artifacts import MaskSet, PosedCapture
from inpaint3d.scene.image_io import read_mask
from inpaint3d.scene.masked_views import load_masked_scene
from inpaint3d.scene.reprojection import correspondences
from inpaint3d.scene.synthetic import BALL_RADIUS
from tests.mask_bench import FAST, Bench, field, make_bench

BALL = {"kind": "sphere", "centre": [0, 0, 0], "radius": 1.05 * BALL_RADIUS}


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Bench:
    made = make_bench(tmp_path_factory.mktemp("store"))
    return Bench(made.store, made.scene, made.inputs | {"radiance-field": field(made.store, made.scene)})


def count_views(bench: Bench, index: int, masks: list[np.ndarray]) -> np.ndarray:
    """How many other views show, outside their masks, what lies behind each pixel of a view in the emptied room."""
    scene = bench.scene
    count = np.zeros(masks[index].shape, int)
    for other in range(len(scene.cameras)):
        if other == index:
            continue
        xy, seen = correspondences(
            scene.cameras[index], scene.empty_depths[index], scene.cameras[other], scene.empty_depths[other], 0.02
        )
        x, y = np.where(seen[..., None], xy, 0).astype(int).transpose(2, 0, 1)
        count += seen & ~masks[other][y, x]
    return count


def test_what_is_left_out_is_shown_by_other_views_and_what_is_kept_is_not(bench):
    metadata, root = bench.author(BALL)
    masks = [read_mask(root / view.mask) for view in metadata.views]
    unseen = [read_mask(root / view.unseen) for view in metadata.views]
    for i, (mask, hidden) in enumerate(zip(masks, unseen, strict=True)):
        assert not (hidden & ~mask).any()
        shown = count_views(bench, i, masks)
        assert (shown[mask & ~hidden] >= 1).mean() > 0.95, "hardly a pixel goes that nobody shows"
        assert hidden[mask & (shown == 0)].mean() > 0.95
    assert sum(h.sum() for h in unseen) < 0.8 * sum(m.sum() for m in masks)


def test_the_set_says_which_of_the_two_is_the_hole(bench):
    for hole in ("object", "unseen"):
        metadata, root = bench.author(BALL, config=FAST.model_copy(update={"hole": hole}))
        digest = bench.store.put(root, "mask-set", metadata)
        posed = bench.store.open(bench.inputs["posed-capture"], PosedCapture)
        scene = load_masked_scene(posed, bench.store.open(digest, MaskSet))
        for view, record in zip(scene.train, metadata.views, strict=False):
            mask = read_mask(root / record.mask)
            wanted = mask if hole == "object" else read_mask(root / record.unseen)
            np.testing.assert_array_equal(view.hole, wanted)
            assert not (view.known & mask).any(), "what is masked is never looked at"


def test_an_outpainting_has_no_smaller_mask(bench):
    metadata, _ = bench.author({"kind": "outpaint", "radius": 0.3}, config=FAST.model_copy(update={"hole": "unseen"}))
    assert metadata.hole == "object"
    assert all(view.unseen is None for view in metadata.views)
