"""A clip becomes frames: the sharpest, spread by motion, upright, SDR."""

import cv2
import numpy as np
import pytest

from inpaint3d.scene.image_io import read_image
from inpaint3d.stages.capture_ingest.config import Config
from inpaint3d.stages.capture_ingest.found import Found
from inpaint3d.stages.capture_ingest.layouts import find
from inpaint3d.stages.capture_ingest.video import choose_frames
from tests.clips import HLG, PQ, tag_clip, write_clip


def found_in(folder, tmp_path, **options) -> Found:
    return find(folder, Config(**options), tmp_path / "work")


def test_video_takes_the_sharpest_of_each_stretch(tmp_path):
    rng = np.random.default_rng(0)
    sharp = (rng.random((48, 64, 3)) * 255).astype(np.uint8)
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for i in range(12):
        writer.write(sharp if i % 4 == 2 else cv2.GaussianBlur(sharp, (0, 0), 3))
    writer.release()
    found = found_in(tmp_path, tmp_path, video_frames=3)
    assert [f.name for f in found.frames] == ["frame_000002", "frame_000006", "frame_000010"]
    assert read_image(found.frames[0].image).shape == (48, 64, 3)


def test_frames_of_a_video_are_spread_by_motion_not_by_time(tmp_path):
    """The camera rests for two thirds of the clip, then walks: what rests is taken once."""
    rng = np.random.default_rng(0)
    wide = cv2.GaussianBlur((rng.random((48, 300, 3)) * 255).astype(np.uint8), (0, 0), 2)
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30, (64, 48))
    for i in range(60):
        at = 4 * max(0, i - 40)
        writer.write(wide[:, at : at + 64])
    writer.release()
    found = found_in(tmp_path, tmp_path, video_frames=6)
    numbers = [int(f.name[6:]) for f in found.frames]
    assert len(numbers) == 6
    assert sum(n <= 40 for n in numbers) <= 1
    assert np.diff([n for n in numbers if n > 40]).max() <= 7
    assert "39 change nothing" in found.notes[-1] or "40 change nothing" in found.notes[-1]


# cd/m2 -> code, 0 to 1 (ITU-R BT.2100, tables 4 and 5; HLG on a display of 1000 cd/m2, gamma 1.2)
def pq(light):
    y = (light / 10000) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * y) / (1 + 18.6875 * y)) ** 78.84375


def hlg(light):
    e = (light / 1000) ** (1 / 1.2)
    return np.where(
        e <= 1 / 12, np.sqrt(3 * e), 0.17883277 * np.log(12 * np.maximum(e, 1 / 12) - 0.28466892) + 0.55991073
    )


@pytest.mark.parametrize(("transfer", "encode"), [(PQ, pq), (HLG, hlg)])
def test_hdr_clips_are_brought_to_sdr_at_203_candela(tmp_path, transfer, encode):
    """Reference white (ITU-R BT.2408) becomes white, what is brighter is clipped, below it BT.1886's 2.4 is kept."""
    light = np.array([2.0, 10, 30, 60, 100, 150, 203, 400, 1000])
    codes = np.repeat(np.round(255 * encode(light)), 16).astype(np.uint8)
    picture = np.repeat(np.tile(codes, (48, 1))[..., None], 3, 2)
    write_clip(tmp_path / "walk.mp4", [picture, picture])
    tag_clip(tmp_path / "walk.mp4", transfer)
    shown = 255 * read_image(found_in(tmp_path, tmp_path).frames[0].image)[24, 8::16, 1]  # MPEG-4 of 8 bits tints grey
    wanted = 255 * np.minimum(light / 203, 1) ** (1 / 2.4)
    np.testing.assert_allclose(shown, wanted, atol=6)  # of 8 bits of PQ, one is 4 % of the light


def test_frames_of_a_still_video_are_spread_by_time():
    chosen = choose_frames(np.array([1.0, 2, 1, 1, 3, 1]), np.zeros(6), 2)
    assert chosen == [1, 4]


def test_a_cut_is_no_motion():
    change = np.full(41, 0.05)
    change[20] = 1.0
    assert len([i for i in choose_frames(np.ones(41), change, 10) if i < 20]) in (4, 5)
