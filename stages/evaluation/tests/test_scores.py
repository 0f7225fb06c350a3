import csv
import math

import numpy as np
import pytest

from inpaint3d.stages.evaluation.scores import Scores, bootstrap_interval


def test_means_are_over_the_views_of_a_method(tmp_path):
    scores = Scores()
    scores.add("p", "a", "v0", {"psnr": 10.0, "ssim": 0.5})
    scores.add("p", "a", "v1", {"psnr": 20.0})
    scores.add("q", "a", "v1", {"psnr": 99.0})
    found = {(m.method, m.name): (m.value, m.views, m.unit) for m in scores.means("p")}
    assert found == {("a", "psnr"): (15.0, 2, "dB"), ("a", "ssim"): (0.5, 1, "1")}
    scores.write(tmp_path / "t.csv")
    with (tmp_path / "t.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4
    assert rows[0] == {"protocol": "p", "method": "a", "view": "v0", "metric": "psnr", "value": "10.0"}


def test_views_that_equal_the_truth_are_counted_and_kept_out_of_the_mean(tmp_path):
    scores = Scores()
    for view, value in (("v0", 20.0), ("v1", math.inf), ("v2", 30.0)):
        scores.add("p", "a", view, {"psnr": value})
        scores.add("p", "same", view, {"psnr": math.inf})
    found = {m.method: m for m in scores.means("p")}
    assert (found["a"].value, found["a"].views, found["a"].equal_views) == (25.0, 2, 1)
    assert "same" not in found  # no view has a finite figure
    scores.write(tmp_path / "t.csv")
    assert "p,a,v1,psnr,inf" in (tmp_path / "t.csv").read_text()


def test_the_interval_is_the_bootstraps_and_holds_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(5)
    hits = [low <= 3.0 <= high for low, high in (bootstrap_interval(rng.normal(3.0, 2.0, 30)) for _ in range(300))]
    assert 0.89 <= np.mean(hits) <= 0.98  # 30 views: a little under 95 %
    assert bootstrap_interval(np.full(7, 2.5)) == (2.5, 2.5)


def test_the_interval_of_a_metric_is_of_its_views():
    scores = Scores()
    for view, value in enumerate([20.0, 21.0, 25.0, 26.0]):
        scores.add("p", "a", f"v{view}", {"psnr": value})
    [m] = scores.means("p")
    assert (m.low, m.high) == pytest.approx(bootstrap_interval(np.array([20.0, 21.0, 25.0, 26.0])), abs=1e-6)
    assert 20.0 <= m.low < m.value < m.high <= 26.0
