from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.models.artifacts import EffectPlan, IgnoredFrame
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.evidence_masks import IgnoredPixels, write_ignored

CAMERA = Camera(10.0, 10.0, 4.0, 3.0, 8, 6, np.eye(4))
ALL = np.ones((6, 8), bool)


@dataclass
class Folder:
    metadata: EffectPlan
    root: Path


@pytest.fixture
def plan(tmp_path):
    passing = np.zeros((6, 8), bool)
    passing[:, 5:] = True
    ignored = [*write_ignored(tmp_path, "transients", {"a": passing}), IgnoredFrame(name="b", effect="blur")]
    return Folder(EffectPlan(effects=(), ignored=tuple(ignored)), tmp_path)


def test_masked_pixels_and_whole_frames_are_no_evidence(plan):
    ignored = IgnoredPixels(plan)
    known = ignored.take_from(ALL, "a", CAMERA)
    assert known[:, :5].all()
    assert not known[:, 5:].any()
    assert not ignored.take_from(ALL, "b", CAMERA).any()


def test_who_completes_pictures_keeps_whole_frames(plan):
    ignored = IgnoredPixels(plan, whole_frames=False)
    assert ignored.take_from(ALL, "b", CAMERA).all()
    assert not ignored.take_from(ALL, "a", CAMERA).all()


def test_without_a_plan_or_for_other_views_the_same_array_comes_back(plan):
    assert IgnoredPixels(None).take_from(ALL, "a", CAMERA) is ALL
    assert IgnoredPixels(plan).take_from(ALL, "c", CAMERA) is ALL
