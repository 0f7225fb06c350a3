import numpy as np

from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.capture_io import SparsePoints
from inpaint3d.stages.evaluation.photos import Photo
from inpaint3d.stages.evaluation.sparse import choose_judges, find_known_rows

CAMERA = Camera(60, 60, 24, 18, 48, 36, look_at((0.9, 0, 0.3), (0, 0, 0)))


def photo(known: np.ndarray, split: str = "train") -> Photo:
    return Photo("view", split, CAMERA.resize_to(24, 18), np.zeros((18, 24, 3), np.float32), ~known, known)


def test_sightings_under_a_mask_are_left_out_at_the_photos_own_size() -> None:
    known = np.ones((18, 24), bool)
    known[:, 12:] = False
    points = SparsePoints(
        xyz=np.zeros((2, 3), np.float32), rgb=np.zeros((2, 3), np.uint8), error=np.zeros(2, np.float32),
        track_offsets=np.array([0, 2, 4]), track_frame=np.array([0, 1, 0, 1], np.int32),
        track_xy=np.float32([[10, 10], [10, 10], [30, 10], [48, 36]]),
    )  # fmt: skip
    rows = find_known_rows(points, [CAMERA, CAMERA], [photo(known), photo(np.ones((18, 24), bool))])
    assert rows.tolist() == [True, True, False, True]


def test_held_out_photos_judge_where_they_saw_something_known() -> None:
    everything = np.ones((18, 24), bool)
    points = SparsePoints(
        xyz=np.zeros((1, 3), np.float32), rgb=np.zeros((1, 3), np.uint8), error=np.zeros(1, np.float32),
        track_offsets=np.array([0, 3]), track_frame=np.array([0, 1, 1], np.int32),
        track_xy=np.zeros((3, 2), np.float32),
    )  # fmt: skip
    photos, known = [photo(everything), photo(everything, "test")], np.array([True, True, False])
    rows, split = choose_judges(known, points, photos)
    assert (rows.tolist(), split) == ([False, True, False], "held-out")
    rows, split = choose_judges(np.array([True, False, False]), points, photos)
    assert (rows.tolist(), split) == ([True, False, False], "training")
