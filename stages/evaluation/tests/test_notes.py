from inpaint3d.contracts.models.artifacts import MaskSet, Protocol
from inpaint3d.stages.evaluation.notes import list_weaknesses
from inpaint3d.stages.evaluation.scores import metric

MASKS = MaskSet(kind="volume", task="inpaint", origin="sphere", method="by hand", views=(), consistency=0.9)
KNOWN = Protocol(
    name="held-out-known-pixels",
    description="",
    metrics=(metric("joint", "psnr", 27.0, 4), metric("mean-colour", "psnr", 14.0, 4)),
)


def said(joint: dict[str, float], control: dict[str, float]) -> str:
    scores = {"joint": joint, "continued-reconstruction": control}
    figures = tuple(metric(method, name, value, 4) for method, row in scores.items() for name, value in row.items())
    box = Protocol(name="bbox10-vgg", description="", metrics=figures)
    return " ".join(list_weaknesses("joint", [box, KNOWN], MASKS, truth=True))


def test_a_prior_that_loses_to_the_same_steps_without_it_is_named() -> None:
    weak = said({"psnr": 23.4, "lpips_vgg": 0.34}, {"psnr": 22.5, "lpips_vgg": 0.32})
    assert "by LPIPS joint adds nothing" in weak
    assert "0.340 against 0.320 (PSNR 23.40 against 22.50 dB)" in weak
    assert "adds nothing" not in said({"psnr": 23.4, "lpips_vgg": 0.30}, {"psnr": 22.5, "lpips_vgg": 0.32})


def test_seeds_that_hardly_differ_are_named() -> None:
    def said_of(lpips: float) -> str:
        between = Protocol(
            name="between-seeds", description="", metrics=(metric("all pairs", "lpips_between", lpips, 4),)
        )
        return " ".join(list_weaknesses("joint", [between, KNOWN], MASKS, truth=False))

    assert "the seeds differ little (LPIPS 0.040" in said_of(0.04)
    assert "differ little" not in said_of(0.2)


def test_a_field_that_loses_to_a_baseline_outside_the_mask_is_named() -> None:
    warped = Protocol(
        name=KNOWN.name, description="", metrics=(*KNOWN.metrics, metric("nearest-photo-warped", "psnr", 28.0, 4))
    )
    weak = " ".join(list_weaknesses("joint", [warped], MASKS, truth=False))
    assert "does not beat nearest-photo-warped on held-out photos (27.00 against 28.00 dB)" in weak
    assert "mean-colour" not in weak
    assert "nothing here says whether the filling is true" in weak
