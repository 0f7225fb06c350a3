import numpy as np
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec
from inpaint3d.radiance.appearance import AppearanceMap
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.scene.synthetic import synthetic_scene


def test_a_picture_in_the_mean_appearance_and_back() -> None:
    """The codes' gain and offset act on logits, as in the field; views of one code are left as they are."""
    spec = FieldSpec.model_validate(
        {
            "proposal_grid": {"levels": 1, "coarsest": 4, "finest": 4, "log2_table": 6, "channels": 1},
            "grid": {"levels": 1, "coarsest": 4, "finest": 4, "log2_table": 6, "channels": 1},
            "proposal_samples": [2], "samples": 2, "density_width": 4, "bottleneck": 3, "view_width": 4,
            "view_layers": 0, "contraction": False, "bound": 1.0, "glo": 2, "glo_views": 3, "near": 0.1, "far": 3.0,
        }
    )  # fmt: skip
    field = RadianceField(spec, seed=0)
    image = synthetic_scene(views=6).images[0].clip(0.05, 0.95)
    with torch.no_grad():
        field.codes.copy_(torch.tensor([[0.3, -0.2], [0.3, -0.2], [-0.4, 0.1]]))
    recolour = AppearanceMap(field)
    there = recolour.to_mean(image, 2)
    assert np.abs(there - image).max() > 0.02
    np.testing.assert_allclose(recolour.from_mean(there, 2), image, atol=1e-4)
    own, mean = field.appearance(torch.tensor([2]), "view"), field.appearance(None, "mean")
    points, along = torch.rand(64, 3, generator=torch.Generator().manual_seed(0)), torch.tensor([[0.0, 0.0, 1.0]])
    assert own is not None
    with torch.no_grad():
        shown, wanted = (field.query(points, along.expand(64, 3), code.expand(64, 6)).rgb for code in (own, mean))
    made = recolour.to_mean(shown[None].numpy(), 2)[0]
    np.testing.assert_allclose(made, wanted.numpy(), atol=1e-4)


def test_without_codes_pictures_stay_as_they_are() -> None:
    image = synthetic_scene(views=6).images[0]
    assert AppearanceMap(None).to_mean(image, 3) is image
