import pytest
from pydantic import ValidationError

from inpaint3d.contracts.artifacts.prior import PriorSpec


def test_a_residual_prior_needs_a_fill() -> None:
    with pytest.raises(ValidationError, match="about the fill"):
        PriorSpec(prediction="residual", condition="noise-fill")
