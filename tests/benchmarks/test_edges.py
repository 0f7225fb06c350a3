"""The measure of straight edges: a known displacement, a known turn, an edge that is gone."""

import cv2
import numpy as np
import pytest
from benchmarks.edges import find_edges, follow_edge, summarise

SIDE = 96
HOLE = np.hypot(*(np.mgrid[:SIDE, :SIDE] - SIDE / 2)) < 26
MIDDLE = (SIDE / 2, SIDE / 2)


def draw_edge(offset: float = 0.0, turn_deg: float = 0.0) -> np.ndarray:
    """Light above a border that is nearly level through the middle, dark below."""
    y, x = np.mgrid[:SIDE, :SIDE].astype(np.float32) + 0.5
    slope = np.tan(np.radians(8 + turn_deg))
    across = (y - MIDDLE[1] - offset - slope * (x - MIDDLE[0])) / np.sqrt(1 + slope**2)
    grey = 0.3 + 0.4 / (1 + np.exp(2 * across))
    return np.repeat(grey[..., None], 3, -1).astype(np.float32)


def measure(picture: np.ndarray) -> dict[str, float | None]:
    truth = draw_edge()
    seen = np.where(HOLE[..., None], picture, truth)
    edges = find_edges(truth, HOLE)
    assert edges
    return summarise([follow_edge(edge, edge.inside, truth, seen) for edge in edges])


def test_the_truth_is_found_whole_and_in_place() -> None:
    found = measure(draw_edge())
    assert (found["share_of_length"], found["offset_px"], found["angle_deg"]) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("offset", [-3.0, 1.5])
def test_an_edge_that_goes_on_elsewhere(offset: float) -> None:
    found = measure(draw_edge(offset))
    assert found["offset_px"] == pytest.approx(abs(offset) * np.cos(np.radians(8)), abs=0.15)
    assert found["angle_deg"] == pytest.approx(0, abs=0.5)


def test_an_edge_that_bends_at_the_hole() -> None:
    found = measure(draw_edge(turn_deg=6))
    assert found["angle_deg"] == pytest.approx(6, abs=1)


def test_a_blurred_edge_is_no_edge() -> None:
    found = measure(cv2.GaussianBlur(draw_edge(), (0, 0), 6))
    assert (found["share_of_length"], found["offset_px"]) == (0, None)
