"""Tiny diffusers pipelines of real classes with random weights, built from config."""

import json
from pathlib import Path
from typing import Any

import diffusers
import torch


def scheduler(**options: Any) -> Any:
    plan = {"clip_sample": False, "set_alpha_to_one": False, "beta_schedule": "scaled_linear"}
    return diffusers.DDIMScheduler(beta_start=0.00085, beta_end=0.012, **(plan | options))


def latent_pipeline(folder: Path, channels: int, **plan: Any) -> Any:
    from transformers import CLIPTextConfig, CLIPTextModel, CLIPTokenizer

    torch.manual_seed(0)
    tokens = ["<|startoftext|>", "<|endoftext|>", *"chair", *(f"{letter}</w>" for letter in "chair")]
    (folder / "vocab.json").write_text(json.dumps({token: i for i, token in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    blocks = {"block_out_channels": (8, 16), "layers_per_block": 1, "norm_num_groups": 4}
    vae = diffusers.AutoencoderKL(
        down_block_types=("DownEncoderBlock2D",) * 2, up_block_types=("UpDecoderBlock2D",) * 2, sample_size=32, **blocks
    )
    with torch.no_grad():  # the code's mean, which is all that is taken of it, and no noise about it
        vae.quant_conv.weight[4:].zero_()
        vae.quant_conv.bias[4:].fill_(-60.0)
    unet = diffusers.UNet2DConditionModel(
        sample_size=16, in_channels=channels, out_channels=4, cross_attention_dim=16, attention_head_dim=4,
        down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"), up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
        **blocks,
    )  # fmt: skip
    text = CLIPTextConfig(
        hidden_size=16, intermediate_size=16, num_attention_heads=2, num_hidden_layers=1, vocab_size=len(tokens),
        bos_token_id=0, eos_token_id=1, pad_token_id=1,
    )  # fmt: skip
    pipeline = diffusers.StableDiffusionInpaintPipeline(
        vae=vae.eval(), unet=unet.eval(), text_encoder=CLIPTextModel(text).eval(), scheduler=scheduler(**plan),
        tokenizer=CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt"), model_max_length=8),
        safety_checker=None, feature_extractor=None, requires_safety_checker=False,
    )  # fmt: skip
    pipeline.set_progress_bar_config(disable=True)
    return pipeline


def pixel_pipeline(**plan: Any) -> Any:
    torch.manual_seed(0)
    unet = diffusers.UNet2DModel(
        sample_size=32, block_out_channels=(8, 16), layers_per_block=1, norm_num_groups=4, attention_head_dim=4,
        down_block_types=("DownBlock2D", "AttnDownBlock2D"), up_block_types=("AttnUpBlock2D", "UpBlock2D"),
    )  # fmt: skip
    return diffusers.DDPMPipeline(unet=unet.eval(), scheduler=scheduler(**plan))
