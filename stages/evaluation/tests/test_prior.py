import pytest

from inpaint3d.contracts.models.artifacts import DiffusionPrior, MaskSet, PriorSpec
from inpaint3d.stages.evaluation.notes import list_weaknesses
from inpaint3d.stages.evaluation.prior import held_out_crops

MASKS = MaskSet(kind="volume", task="inpaint", origin="sphere", method="by hand", views=())
FIGURES = {"crops": 24.0, "hole_psnr_sample": 18.0, "lpips_sample": 0.2, "hole_psnr_telea": 19.0, "lpips_telea": 0.3}


def prior(**figures: float) -> DiffusionPrior:
    return DiffusionPrior(spec=PriorSpec(), steps=1, seed=0, trained_on="noise", held_out=FIGURES | figures)


def test_every_fill_that_was_judged_has_its_row() -> None:
    (protocol,) = held_out_crops(prior(start_hole_psnr_sample=17.0, start_lpips_sample=0.25))
    rows = {(m.method, m.name): m.value for m in protocol.metrics}
    assert rows == {
        ("prior", "psnr"): 18.0,
        ("prior", "lpips_vgg"): 0.2,
        ("prior-before-fine-tuning", "psnr"): 17.0,
        ("prior-before-fine-tuning", "lpips_vgg"): 0.25,
        ("telea", "psnr"): 19.0,
        ("telea", "lpips_vgg"): 0.3,
    }
    assert {m.views for m in protocol.metrics} == {24}


def test_a_prior_that_was_not_judged_has_no_table() -> None:
    assert held_out_crops(prior().model_copy(update={"held_out": {}})) == []


@pytest.mark.parametrize(("before", "named"), [(0.25, False), (0.2, True), (0.19, True)])
def test_fine_tuning_that_did_not_help_is_named(before: float, named: bool) -> None:
    done = held_out_crops(prior(start_lpips_sample=before))
    weak = " ".join(list_weaknesses("joint", done, MASKS, truth=True))
    assert ("fine-tuning the prior on this capture did not help" in weak) is named
