"""Pipelines of other people's, as the diffusers library saves them: where they lie, and which files make one up."""

import os
from pathlib import Path

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.untrusted import MAX_JSON_BYTES, parse_json, read_bounded

INDEX = "model_index.json"
SUFFIXES = (".json", ".txt", ".model", ".safetensors")
LEFT_OUT = ("safety_checker",)


def find_pipeline_folder(place: Path) -> Path | None:
    """The folder of a diffusers pipeline: `place` itself, or what the hub's cache has of that name; None for others.

    Nothing is downloaded. Raises ConfigurationError for a place that is no folder and not in the cache.
    """
    if place.is_dir():
        return place if (place / INDEX).is_file() else None
    cached = locate_hub_cache() / f"models--{place.as_posix().replace('/', '--')}"
    revision = cached / "refs" / "main"
    if not revision.is_file():
        raise ConfigurationError(
            f"{place} is neither a folder nor a pipeline in the hub's cache {locate_hub_cache()}; give a folder of a "
            f"diffusion-prior artifact or of a diffusers pipeline, or run `hf download {place}` first"
        )
    return cached / "snapshots" / revision.read_text().strip()


def locate_hub_cache() -> Path:
    """Where the hub's client library keeps what it has downloaded."""
    home = Path(os.environ.get("HF_HOME", "~/.cache/huggingface"))
    return Path(os.environ.get("HF_HUB_CACHE", home / "hub")).expanduser()


def read_kind(folder: Path) -> str:
    """The pipeline's class. Raises ConfigurationError where no denoising UNet is part of it."""
    try:
        index = parse_json(read_bounded(folder / INDEX, MAX_JSON_BYTES))
        kind, parts = str(index["_class_name"]), set(index)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{folder / INDEX} is not that of a diffusers pipeline ({error!r})") from error
    if "unet" not in parts:
        raise ConfigurationError(
            f"{folder} is a {kind} without a UNet; give a pipeline like Stable Diffusion's inpainting one"
        )
    return kind


def list_pipeline_files(folder: Path) -> list[Path]:
    """Configurations and safetensors weights; no other precisions (`x.fp16.safetensors`) and no unused parts."""
    return [
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix in SUFFIXES and not _is_superfluous(path.relative_to(folder))
    ]


def _is_superfluous(path: Path) -> bool:
    loose_weights = len(path.parts) == 1 and path.name != INDEX
    variant = path.suffix == ".safetensors" and "." in path.stem
    return loose_weights or variant or path.parts[0] in LEFT_OUT or any(part.startswith(".") for part in path.parts)
