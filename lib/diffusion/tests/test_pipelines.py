import json
import sys
from pathlib import Path

import pytest
import torch

from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.diffusion.pipelines import PipelinePrior, load_pipeline
from inpaint3d.diffusion.samplers import ddim, inpaint
from inpaint3d.diffusion.schedules import alpha, cosine_log_snr, cosine_time, per_image, sigma
from tests.tiny_pipelines import latent_pipeline, pixel_pipeline

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")
diffusers = pytest.importorskip("diffusers")


@pytest.fixture
def picture() -> torch.Tensor:
    coarse = torch.rand(2, 3, 4, 4, generator=torch.Generator().manual_seed(7)) * 2 - 1
    return torch.nn.functional.interpolate(coarse, size=32, mode="bilinear")


@pytest.fixture
def hole() -> torch.Tensor:
    mask = torch.zeros(2, 1, 32, 32)
    mask[:, :, 8:20, 10:26] = 1
    return mask


@pytest.mark.parametrize("prediction", ["epsilon", "v_prediction"])
def test_sampling_is_what_the_pipeline_itself_does(prediction, picture, hole, tmp_path: Path) -> None:
    pipeline = latent_pipeline(tmp_path, 9, prediction_type=prediction, steps_offset=1)
    prior = PipelinePrior(pipeline, prompt="chair")
    noise = torch.randn(2, 4, 16, 16, generator=torch.Generator().manual_seed(0))
    theirs = pipeline(
        prompt=["chair"] * 2, image=(picture + 1) / 2, mask_image=hole, num_inference_steps=6, guidance_scale=1.0,
        latents=noise, height=32, width=32, output_type="pt",
    ).images  # fmt: skip
    # The same noise levels as the pipeline's own, its last one included: it ends at the table's first row.
    steps = [*pipeline.scheduler.timesteps.tolist(), 0]
    times = cosine_time(prior.log_snr[steps])
    ours = ddim(lambda z, t: prior.predict_noise(z, t, picture, hole), noise, times)
    # A clean picture out of a network of random weights: the t of the levels are float32.
    torch.testing.assert_close((prior.decode(ours).clamp(-1, 1) + 1) / 2, theirs, rtol=0, atol=1e-4)
    assert theirs.std() > 0.02


@pytest.mark.parametrize("channels", [9, 4])
def test_alatent_pipeline_keeps_known_pixels_and_never_sees_the_hole(channels, picture, hole, tmp_path: Path) -> None:
    prior = PipelinePrior(latent_pipeline(tmp_path, channels))
    assert isinstance(prior, Denoiser)
    assert prior.size == 32
    one, other = (
        inpaint(prior, x, hole, steps=3, generator=torch.Generator().manual_seed(0), guidance=2.0)
        for x in (picture, torch.where(hole > 0, torch.nan, picture))
    )
    known = (1 - hole).expand_as(picture) > 0
    assert torch.equal(one[known], picture[known])
    assert torch.equal(one, other)
    assert one.abs().max() <= 1


def test_known_pixels_are_noised_exactly_where_a_model_is_not_shown_the_mask(picture, hole) -> None:
    prior = PipelinePrior(pixel_pipeline())
    t, eps = torch.tensor([0.3, 0.8]), torch.randn(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    z = per_image(alpha(t)) * picture + per_image(sigma(t)) * eps
    noise = prior.predict_noise(z, t, picture, hole)
    known = (1 - hole).expand_as(picture) > 0
    # (z - alpha x) / sigma cancels a few digits of float32.
    torch.testing.assert_close(noise[known], eps[known], rtol=0, atol=1e-5)
    inside = prior.unet(z, prior.timestep(t)).sample
    assert torch.equal(noise[~known], inside[~known])


def test_a_pipeline_with_two_text_encoders_is_refused(tmp_path: Path) -> None:
    pipeline = latent_pipeline(tmp_path, 9)
    pipeline.text_encoder_2 = pipeline.text_encoder
    with pytest.raises(ValueError, match="has two text encoders"):
        PipelinePrior(pipeline)


def test_what_is_shown_is_encoded_once(picture, hole, tmp_path: Path) -> None:
    prior = PipelinePrior(latent_pipeline(tmp_path, 9))
    made: list[int] = []
    prior.vae.encoder.register_forward_hook(lambda *_: made.append(1))
    z, t = torch.zeros(2, *prior.latent_shape), torch.tensor([0.4, 0.9])
    asked = [prior.predict_noise(z, t, picture, hole, guidance=2.0) for _ in range(3)]
    assert len(made) == 2  # the picture and the null condition's
    assert torch.equal(asked[0], asked[2])
    other = prior.predict_noise(z, t, -picture, hole, guidance=2.0)
    assert len(made) == 3
    assert torch.equal(
        other, PipelinePrior(latent_pipeline(tmp_path, 9)).predict_noise(z, t, -picture, hole, guidance=2.0)
    )


def test_guidance_leads_away_from_an_all_hole_picture_without_a_text(picture, hole, tmp_path: Path) -> None:
    pipeline = latent_pipeline(tmp_path, 9)
    told, untold = PipelinePrior(pipeline, prompt="chair"), PipelinePrior(pipeline)
    z, t = torch.randn(2, 4, 16, 16, generator=torch.Generator().manual_seed(0)), torch.tensor([0.4, 0.9])
    conditional = told.predict_noise(z, t, picture, hole)
    null = untold.predict_noise(z, t, torch.zeros_like(picture), torch.ones_like(hole))
    assert not torch.equal(conditional, untold.predict_noise(z, t, picture, hole))
    guided = told.predict_noise(z, t, picture, hole, guidance=3.0)
    torch.testing.assert_close(guided, null + 3 * (conditional - null))


def test_it_is_asked_at_the_row_of_its_table_that_is_as_noisy() -> None:
    prior = PipelinePrior(pixel_pipeline())
    rows = torch.tensor([0, 1, 500, 998, 999])
    torch.testing.assert_close(prior.timestep(cosine_time(prior.log_snr[rows])), rows.float(), rtol=0, atol=1e-2)
    between = prior.timestep(cosine_time((prior.log_snr[500:501] + prior.log_snr[501:502]) / 2))
    torch.testing.assert_close(between, torch.tensor([500.5]), rtol=0, atol=1e-2)
    # Beyond its noisiest and its cleanest row it can only be asked there.
    assert prior.timestep(torch.tensor([0.0, 1.0])).tolist() == [0.0, 999.0]
    assert cosine_log_snr(torch.ones(1)).item() < prior.log_snr[-1].item()


def test_a_safety_checker_that_is_named_need_not_be_there(tmp_path: Path) -> None:
    """The orchestrator leaves it behind; nothing of it is used."""
    pipeline = latent_pipeline(tmp_path, 9)
    pipeline.save_pretrained(tmp_path / "model")
    index = tmp_path / "model" / "model_index.json"
    named = {"safety_checker": ["stable_diffusion", "StableDiffusionSafetyChecker"], "requires_safety_checker": True}
    index.write_text(json.dumps(json.loads(index.read_text()) | named))
    z, t = torch.zeros(1, 4, 16, 16), torch.tensor([0.4])
    asked = [torch.zeros(1, 3, 32, 32), torch.ones(1, 1, 32, 32)]
    loaded = load_pipeline(str(tmp_path / "model")).predict_noise(z, t, *asked)
    torch.testing.assert_close(loaded, PipelinePrior(pipeline).predict_noise(z, t, *asked))


def test_a_folder_is_loaded_and_what_cannot_be_is_named(tmp_path: Path, picture, hole, monkeypatch) -> None:
    pipeline = pixel_pipeline()
    pipeline.save_pretrained(tmp_path / "model")
    loaded, t = load_pipeline(str(tmp_path / "model")), torch.tensor([0.3, 0.8])
    expected = PipelinePrior(pipeline).predict_noise(picture, t, picture, hole)
    assert torch.equal(loaded.predict_noise(picture, t, picture, hole), expected)
    with pytest.raises(ValueError, match="nowhere is no folder of a diffusers pipeline"):
        load_pipeline(str(tmp_path / "nowhere"))
    pipeline.scheduler = diffusers.FlowMatchEulerDiscreteScheduler()
    with pytest.raises(ValueError, match="DDPMPipeline has no UNet with DDPM's noise"):
        PipelinePrior(pipeline)
    monkeypatch.setitem(sys.modules, "diffusers.pipelines.pipeline_utils", None)
    with pytest.raises(ValueError, match="needs diffusers, which is not installed; run"):
        load_pipeline(str(tmp_path / "model"))
