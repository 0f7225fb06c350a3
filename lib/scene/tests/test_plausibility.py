"""What is said of results that cannot be right, and the answers that a field has to beat."""

from pathlib import Path

import numpy as np
import pytest

from inpaint3d.scene.capture_io import View
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.plausibility import (
    MEAN_COLOUR,
    WARPED,
    CompletedHole,
    doubt_completion,
    doubt_field,
    doubt_masks,
    measure_baselines,
    measure_completions,
)
from inpaint3d.scene.synthetic import synthetic_scene

SCENE = synthetic_scene(views=9, width=96, height=72, points=600)
BASELINES = {MEAN_COLOUR: 12.0, WARPED: 15.0}
# Measured: phone photos of a stuffed fox, a statue, a bear on a turntable, the demo's room.
GOOD = [(25.6, 0.0034, 0.0044), (23.4, 0.0081, 0.0040), (20.2, 0.0050, 0.014), (24.6, 0.0048, 0.0081)]


@pytest.mark.parametrize(("psnr", "depth_error", "floaters"), GOOD)
def test_good_captures_leave_no_doubt(psnr, depth_error, floaters):
    assert doubt_field(psnr, BASELINES, depth_error, floaters) == []


def test_photos_that_stand_close_together_are_no_reason_to_doubt_a_field():
    """The demo's own: its 43 photos lie on one arc, and the nearest one, warped, scores what 800 steps do."""
    assert doubt_field(24.6, {MEAN_COLOUR: 12.0, WARPED: 24.6}, 0.0048, 0.0081) == []


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ((11.9, 0.37, 0.49), ["the nearest photo, warped 15.0 dB", "off by 37%", "49% of the light"]),
        ((13.9, 0.37, 0.49), ["off by 37%", "49% of the light"]),
        ((12.5, 0.01, 0.01), ["12.5 dB, the mean colour of the photos 12.0 dB: at least 13.0 dB"]),
        ((20.0, 0.15, 0.01), ["off by 15%"]),
        ((20.0, 0.01, 0.40), ["40% of the light"]),
    ],
)
def test_each_figure_is_told_with_a_repair(figures, words):
    psnr, depth_error, floaters = figures
    (doubt,) = doubt_field(psnr, BASELINES, depth_error, floaters)
    for word in words:
        assert word in doubt
    assert "pose-estimation.cameras=estimate" in doubt


def test_what_was_not_measured_is_not_doubted():
    assert doubt_field(None, BASELINES, None, None) == []
    assert doubt_masks(0.2, None, outside=False) == []


@pytest.mark.parametrize(
    ("share", "consistency", "outside", "words"),
    [
        (0.08, 0.85, False, None),
        (0.9, None, True, None),
        (0.9, 0.8, False, "cover 90% of the pictures"),
        (0.1, 0.05, False, "agree by 0.05"),
    ],
)
def test_masks_over_everything_or_of_different_things_are_doubted(share, consistency, outside, words):
    doubts = doubt_masks(share, consistency, outside=outside)
    assert (words is None and doubts == []) or words in doubts[0]


def completed(order: list[int]) -> list[CompletedHole]:
    """The room without its ball, in some order of the pictures, at half size."""
    half = [np.asarray(depth[::2, ::2], np.float32) for depth in SCENE.empty_depths]
    return [
        CompletedHole.of(camera, SCENE.empty_images[order[i]], half[i], SCENE.object_masks[i])
        for i, camera in enumerate(SCENE.cameras)
    ]


def test_holes_filled_with_one_thing_agree_and_with_many_do_not():
    one, many = (
        measure_completions(completed(list(range(9)))),
        measure_completions(completed([5, 0, 7, 2, 8, 1, 4, 6, 3])),
    )
    assert one is not None
    assert many is not None
    assert doubt_completion(one) == []
    (doubt,) = doubt_completion(many)
    assert f"{many:.1f} dB between neighbours" in doubt


def test_a_completion_that_cannot_be_compared_is_not_doubted():
    assert measure_completions([]) is None
    assert measure_completions(completed(list(range(9)))[:1]) is None
    assert doubt_completion(None) == []


def views(folder: Path, order: list[int]) -> list[View]:
    """The scene's views, with the pictures in some order."""
    made = []
    for i, (name, camera) in enumerate(zip(SCENE.names, SCENE.cameras, strict=True)):
        write_png(folder / f"{name}.png", SCENE.images[order[i]])
        made.append(View(name, camera, "train", None, folder / f"{name}.png"))
    return made


def test_the_nearest_photo_beats_the_mean_colour_where_cameras_are_right(tmp_path):
    right = views(tmp_path, list(range(9)))
    test, train = [right[2], right[6]], [v for i, v in enumerate(right) if i not in (2, 6)]
    found = measure_baselines(train, test, SCENE.points)
    mean = np.mean([v.image()[::8, ::8].reshape(-1, 3).mean(0) for v in train], 0)
    exact = [-10 * np.log10(np.mean((v.image() - mean) ** 2)) for v in test]
    assert found[MEAN_COLOUR] == pytest.approx(np.mean(exact), abs=0.05)
    assert found[WARPED] > found[MEAN_COLOUR] + 1


def test_under_wrong_cameras_it_does_not(tmp_path):
    wrong = views(tmp_path, [5, 0, 7, 2, 8, 1, 4, 6, 3])
    found = measure_baselines([v for i, v in enumerate(wrong) if i not in (2, 6)], [wrong[2], wrong[6]], SCENE.points)
    assert found[WARPED] < found[MEAN_COLOUR]


def test_without_views_held_out_there_is_nothing_to_beat(tmp_path):
    assert measure_baselines(views(tmp_path, list(range(9))), [], SCENE.points) == {}
