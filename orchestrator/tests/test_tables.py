from inpaint3d.contracts.models.artifacts import Metric, Protocol
from inpaint3d.orchestrator.pages.tables import Cell, find_best, make_table


def metric(method: str, name: str, value: float, better: str = "higher") -> Metric:
    return Metric(
        method=method, name=name, value=value, unit="dB", better=better, views=2, title=name.upper(), digits=2
    )


def test_the_best_knows_which_way_is_up():
    metrics = [
        metric("a", "psnr", 10), metric("b", "psnr", 12),
        metric("a", "lpips", 0.3, "lower"), metric("b", "lpips", 0.4, "lower"),
        metric("a", "gradient", 0.5, "nearer 1"), metric("b", "gradient", 1.8, "nearer 1"),
    ]  # fmt: skip
    assert find_best(metrics) == {("b", "psnr"), ("a", "lpips"), ("b", "gradient")}


def test_one_method_alone_is_not_best_and_equals_share():
    assert find_best([metric("a", "psnr", 10)]) == set()
    assert find_best([metric("a", "psnr", 10), metric("b", "psnr", 10)]) == {("a", "psnr"), ("b", "psnr")}


def test_a_table_marks_the_best_and_shows_a_dash_for_what_a_method_lacks():
    metrics = (metric("a", "psnr", 1.234), metric("b", "psnr", 2), metric("b", "ssim", 0.5))
    table = make_table(Protocol(name="hole-vs-truth", description="d", metrics=metrics))
    assert (table.title, table.heads[0]) == ("Hole vs truth", ("PSNR", "dB, higher is better"))
    assert table.rows == [("a", [Cell("1.23"), Cell("–")]), ("b", [Cell("2.00", best=True), Cell("0.50")])]
