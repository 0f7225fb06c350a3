from inpaint3d.contracts.models.artifacts import Metric, Protocol
from inpaint3d.orchestrator.pages.tables import Cell, find_best, list_views, make_table


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
    assert (table.title, table.heads[0]) == ("hole-vs-truth, version 1", ("PSNR", "dB, higher is better"))
    assert table.rows == [("a", [Cell("1.23"), Cell("–")]), ("b", [Cell("2.00", best=True), Cell("0.50")])]


def test_intervals_and_conditions_stand_beside_the_figures():
    sure = metric("a", "psnr", 20).model_copy(update={"low": 19.5, "high": 20.25, "equal_views": 1})
    whole = metric("a", "kid", 0.1).model_copy(update={"standard_error": 0.02})
    told = Protocol(name="p", description="d", metrics=(sure, whole), crop="the hole", networks=("vgg16",), views=4)
    table = make_table(told)
    assert table.rows == [("a", [Cell("20.00", about="19.50 to 20.25, 1 views equal"), Cell("0.10", about="± 0.02")])]
    assert table.conditions == {"crop": "the hole", "networks": "vgg16", "n": "4 views"}


def test_views_are_listed_by_protocol(tmp_path):
    lines = ["protocol,method,view,metric,value", "p,a,v0,psnr,20.0", "p,b,v0,psnr,inf", "p,a,v1,psnr,21.5"]
    (tmp_path / "per_view.csv").write_text("\n".join([*lines, "p,a,v0,ssim,0.5", "other,a,v0,psnr,1", ""]))
    told = Protocol(name="p", description="d", metrics=(metric("a", "psnr", 20), metric("b", "psnr", 20)))
    (table,) = list_views(tmp_path / "per_view.csv", [told])
    assert table.heads == [("a", "PSNR"), ("b", "PSNR")]
    assert table.rows == [("v0", ["20.00", "equal"]), ("v1", ["21.50", "–"])]
