import csv

from inpaint3d.stages.evaluation.scores import Scores


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
