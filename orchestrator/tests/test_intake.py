import json
from pathlib import Path

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import DiffusersPipeline
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.orchestrator.diffusers_pipeline import find_pipeline_folder
from inpaint3d.orchestrator.intake import locate_externals, take_capture, take_externals, take_pipeline

REPOSITORY = Path(__file__).parents[2]
INDEX = {"_class_name": "StableDiffusionInpaintPipeline", "unet": ["diffusers", "UNet2DConditionModel"]}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return FolderStore(tmp_path / "store")


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    (folder / ".thumbnails").mkdir(parents=True)
    for name in ("a.jpg", "b.jpg", ".thumbnails/a.jpg"):
        (folder / name).write_bytes(name.encode())
    return folder


def saved(folder: Path, index: dict[str, object] = INDEX) -> Path:
    """A pipeline's folder as the hub has them: other precisions, other formats and unused parts lie there too."""
    for name in (
        "unet/config.json", "unet/diffusion_pytorch_model.safetensors", "unet/diffusion_pytorch_model.fp16.safetensors",
        "unet/diffusion_pytorch_model.bin", "vae/model-00001-of-00002.safetensors", "vae/model.safetensors.index.json",
        "tokenizer/merges.txt", "safety_checker/model.safetensors", "whole.safetensors", "README.md",
        ".git/config.json",
    ):  # fmt: skip
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    (folder / "model_index.json").write_text(json.dumps(index))
    return folder


def test_a_pipeline_is_taken_with_the_files_that_it_is_loaded_from(store: Store, tmp_path: Path) -> None:
    digest = take_pipeline(store, saved(tmp_path / "model"))
    artifact = store.open(digest, DiffusersPipeline)
    assert artifact.metadata.kind == "StableDiffusionInpaintPipeline"
    assert [f.path for f in artifact.manifest.files] == [
        "pipeline/model_index.json",
        "pipeline/tokenizer/merges.txt",
        "pipeline/unet/config.json",
        "pipeline/unet/diffusion_pytorch_model.safetensors",
        "pipeline/vae/model-00001-of-00002.safetensors",
        "pipeline/vae/model.safetensors.index.json",
    ]
    assert take_pipeline(store, saved(tmp_path / "elsewhere")) == digest


def test_a_pipeline_is_found_by_its_name_in_the_hubs_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HF_HUB_CACHE", raising=False)
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    cached = tmp_path / "hub" / "models--somebody--inpainting"
    (cached / "refs").mkdir(parents=True)
    (cached / "refs" / "main").write_text("c0ffee")
    assert find_pipeline_folder(Path("somebody/inpainting")) == cached / "snapshots" / "c0ffee"
    with pytest.raises(ConfigurationError, match="run `hf download somebody/else` first"):
        find_pipeline_folder(Path("somebody/else"))


def test_either_kind_of_prior_is_given_by_one_option(store: Store, capture: Path, tmp_path: Path) -> None:
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml")  # with all its nodes: one reads the one, one the other
    default, foreign, own = (
        take_externals(store, pipeline, capture, locate_externals(mask=None, prior=prior, corpus=None))
        for prior in (None, saved(tmp_path / "model"), REPOSITORY / "priors" / "general")
    )
    assert default == own
    assert set(foreign) - set(default) == {"diffusers-pipeline"}
    assert foreign["pretrained-prior"] == default["pretrained-prior"]


def test_a_pipeline_without_a_unet_is_refused_before_anything_runs(store: Store, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="is a FluxFillPipeline without a UNet"):
        take_pipeline(store, saved(tmp_path / "model", {"_class_name": "FluxFillPipeline", "transformer": []}))


def test_a_capture_is_taken_without_its_hidden_files(store: Store, capture: Path) -> None:
    manifest = store.manifest(take_capture(store, capture))
    assert [f.path for f in manifest.files] == ["raw/a.jpg", "raw/b.jpg"]
    video = store.manifest(take_capture(store, capture / "b.jpg"))
    assert [f.path for f in video.files] == ["raw/b.jpg"]
    assert video.metadata == {"name": "b.jpg", "kind": "file"}
