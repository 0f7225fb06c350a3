import pytest
from pydantic import ValidationError

from inpaint3d.contracts.models.artifacts.prior import DiffusionPrior, PriorSpec


def test_a_residual_prior_needs_a_fill() -> None:
    with pytest.raises(ValidationError, match="about the fill"):
        PriorSpec(prediction="residual", condition="noise-fill")


def test_a_prior_for_onnxruntime_names_its_network() -> None:
    with pytest.raises(ValidationError, match="needs the network as ONNX"):
        DiffusionPrior(spec=PriorSpec(), steps=0, seed=0, trained_on="nothing", runtime="onnxruntime")
