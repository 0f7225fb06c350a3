"""Real runs on the synthetic room, in a store, through the shim."""

import csv
import io
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from inpaint3d.contracts.errors import BadInputError, ConfigurationError, InterruptedRun
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import (
    DiffusionPrior,
    ImageCorpus,
    MaskSet,
    MaskView,
)
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.documents import load_yaml
from inpaint3d.contracts.store import Artifact, FolderStore, Store
from inpaint3d.diffusion.io import load_prior, open_prior
from inpaint3d.scene.image_io import write_mask, write_png
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.stages.diffusion_training.config import OF_LEARNING, SMALL, Config
from tests.room_artifacts import put_posed

MODULE = "inpaint3d.stages.diffusion_training"
TINY: dict[str, Any] = load_yaml(Path(__file__).parent / "tiny.yaml")[0]


@pytest.fixture(scope="module")
def room() -> SyntheticScene:
    return synthetic_scene(views=6)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return FolderStore(tmp_path / "store")


def put_masks(store: Store, room: SyntheticScene, masks: np.ndarray) -> Digest:
    folder, views = store.private_folder(), []
    for name, mask in zip(room.names, masks, strict=True):
        write_mask(folder / "masks" / f"{name}.png", mask)
        views.append(MaskView(name=name, mask=f"masks/{name}.png", share=float(mask.mean())))
    metadata = MaskSet(kind="per-view", task="inpaint", origin="imported", method="synthetic", views=tuple(views))
    return store.put(folder, "mask-set", metadata)


def put_corpus(store: Store, room: SyntheticScene) -> Digest:
    folder, pictures = store.private_folder(), []
    for name, image in zip(room.names, room.empty_images, strict=True):
        write_png(folder / "images" / f"{name}.png", image)
        pictures.append(ImageCorpus.Picture(name=name, path=f"images/{name}.png", scene="room", split="train"))
    return store.put(folder, "image-corpus", ImageCorpus(pictures=tuple(pictures)))


def train(
    store: Store, inputs: Mapping[str, Digest], events: io.TextIOBase | None = None, threads: int = 1, **parameters: Any
) -> Artifact[DiffusionPrior]:
    invocation = Invocation(inputs=dict(inputs), parameters=TINY | parameters, threads=threads)
    record = execute(MODULE, store, invocation, events or io.StringIO())  # pyright: ignore[reportArgumentType]
    return store.open(record.outputs["diffusion-prior"], DiffusionPrior)


@pytest.fixture
def inputs(store: Store, room: SyntheticScene) -> dict[str, Digest]:
    return {
        "posed-capture": put_posed(store, room, room.images),
        "mask-set": put_masks(store, room, room.object_masks),
    }


def test_repainting_what_lies_under_the_masks_changes_no_byte(store, room, inputs) -> None:
    marker = np.where(room.object_masks[..., None], np.float32([1, 0, 1]), room.images)
    repainted = inputs | {"posed-capture": put_posed(store, room, marker)}
    assert inputs["posed-capture"] != repainted["posed-capture"]
    assert train(store, inputs).digest == train(store, repainted).digest


def test_a_known_pixel_does_change_it(store, room, inputs) -> None:
    """The leak test above could not fail if nothing were read at all."""
    brighter = np.where(room.object_masks[..., None], room.images, np.clip(room.images + 0.1, 0, 1))
    changed = inputs | {"posed-capture": put_posed(store, room, brighter)}
    assert train(store, inputs).digest != train(store, changed).digest


class _StopsAt(io.StringIO):
    """An event stream whose reader hits Ctrl-C once a step is reached."""

    def __init__(self, done: int) -> None:
        super().__init__()
        self.done = done

    def write(self, text: str) -> int:
        if f'"done": {self.done},' in text:
            raise InterruptedRun("stopped by the test")
        return super().write(text)


def test_a_run_that_was_stopped_goes_on_to_the_same_bytes(store, inputs, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(f"{MODULE}.teaching.CHECKPOINT_S", 0.0)
    monkeypatch.setattr("inpaint3d.contracts.kit.context.PROGRESS_INTERVAL_S", 0.0)
    with pytest.raises(InterruptedRun):
        train(store, inputs, _StopsAt(4))
    events = io.StringIO()
    resumed = train(store, inputs, events)
    assert "going on from step 4" in events.getvalue()

    elsewhere = FolderStore(tmp_path / "elsewhere")
    for digest in inputs.values():
        elsewhere.adopt(store.object_path(digest), store.manifest(digest))
    assert train(elsewhere, inputs).digest == resumed.digest


def test_killed_without_warning_it_goes_on_to_the_same_bytes(store, inputs, tmp_path) -> None:
    plan = TINY | {"steps": 30, "curve_rows": 10}
    (tmp_path / "invocation.json").write_text(Invocation(inputs=inputs, parameters=plan, threads=1).model_dump_json())
    script = (
        f"import {MODULE}.teaching as teaching; teaching.CHECKPOINT_S = 0\n"
        f"from inpaint3d.contracts.kit.shim import serve; serve('{MODULE}')"
    )
    options = ["run", "--store", str(store.root), "--invocation", str(tmp_path / "invocation.json")]
    process = subprocess.Popen([sys.executable, "-c", script, *options], stdout=subprocess.DEVNULL)
    while not list(store.root.glob("work/*/checkpoint.safetensors")):
        assert process.poll() is None, "it ended before its first checkpoint"
        time.sleep(0.01)
    process.kill()
    process.wait()

    events = io.StringIO()
    resumed = train(store, inputs, events, **plan)
    assert "going on from step" in events.getvalue()
    elsewhere = FolderStore(tmp_path / "elsewhere")
    for digest in inputs.values():
        elsewhere.adopt(store.object_path(digest), store.manifest(digest))
    unbroken = train(elsewhere, inputs, **plan)
    assert resumed.path("training_curve.csv").read_text() == unbroken.path("training_curve.csv").read_text()
    assert resumed.digest == unbroken.digest


def test_threads_on_offer_change_no_byte(store, inputs, tmp_path) -> None:
    elsewhere = FolderStore(tmp_path / "elsewhere")
    for digest in inputs.values():
        elsewhere.adopt(store.object_path(digest), store.manifest(digest))
    # At the full size: a tiny network's sums are not split over threads, and could not tell.
    full = {"prior": SMALL.model_dump(), "steps": 2, "batch": 8, "exam": 1}
    assert train(store, inputs, **full).digest == train(elsewhere, inputs, threads=2, **full).digest


def test_what_it_writes_can_be_queried_and_tells_how_it_went(store, inputs) -> None:
    prior = train(store, inputs)
    network = load_prior(prior.path(prior.metadata.weights), prior.metadata.spec)
    assert sum(p.abs().sum().item() for p in network.network.head.parameters()) > 0
    rows = list(csv.DictReader(prior.path("training_curve.csv").read_text().splitlines()))
    assert [int(row["step"]) for row in rows] == [2, 4, 6]
    assert all(float(row["loss"]) > 0 and float(row["held_out_loss"]) > 0 for row in rows)
    judged = {"hole_psnr_sample", "hole_psnr_expectation", "hole_psnr_telea", "lpips_sample", "lpips_telea"}
    assert judged <= set(prior.metadata.held_out)
    assert prior.metadata.start == "scratch"
    assert prior.metadata.trained_on.startswith("5 frames of the capture without the")
    assert all(prior.path(sample).stat().st_size > 100 for sample in prior.metadata.samples)


def test_learning_a_smooth_room_beats_not_having_learnt(store, room, inputs) -> None:
    """The room's own texture is random, which nobody can guess; blurred, noise can be told from picture."""
    smooth = np.stack([cv2.GaussianBlur(image, (0, 0), 3) for image in room.images])
    inputs = inputs | {"posed-capture": put_posed(store, room, smooth)}
    prior = train(store, inputs, steps=60, batch=4, exam=12, learning_rate=3e-3, ema=0.9, curve_rows=60)
    rows = list(csv.DictReader(prior.path("training_curve.csv").read_text().splitlines()))
    # The first row is after one step.
    assert float(rows[-1]["held_out_loss"]) < 0.97 * float(rows[0]["held_out_loss"])


def test_fine_tuning_starts_from_the_pretrained_prior(store, inputs) -> None:
    first = train(store, inputs)
    other_spec = TINY["prior"] | {"width": 16}
    usual = {name: Config.model_fields[name].default for name in OF_LEARNING}
    tuned = train(store, inputs | {"pretrained-prior": first.digest}, **usual, steps=0, prior=other_spec)
    assert tuned.metadata.start == first.digest
    assert tuned.metadata.spec == first.metadata.spec
    # No step: the weights are the pretrained ones, and so are the figures.
    assert tuned.path("weights.safetensors").read_bytes() == first.path("weights.safetensors").read_bytes()
    figures = tuned.metadata.held_out
    assert figures["start_hole_psnr_expectation"] == figures["hole_psnr_expectation"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"start": "fresh"}, "steps is 0 and start is fresh: nothing would be learnt"),
        ({"batch": 4}, "batch would change nothing: steps is 0"),
        ({"fine_tuning_rate": 1e-4, "ema": 0.5}, "fine_tuning_rate, ema would change nothing"),
    ],
)
def test_what_would_teach_nothing_is_refused(given, said) -> None:
    with pytest.raises(ValueError, match=said):
        Config.model_validate({"steps": 0, **given})
    assert Config.model_validate({"steps": 1, **given}).steps == 1


def test_a_fresh_start_leaves_the_pretrained_prior_alone(store, inputs) -> None:
    first = train(store, inputs, steps=1)
    fresh = train(store, inputs | {"pretrained-prior": first.digest}, start="fresh")
    assert fresh.metadata.start == "scratch"
    assert (
        fresh.path("weights.safetensors").read_bytes() == train(store, inputs).path("weights.safetensors").read_bytes()
    )


def test_a_corpus_is_learnt_from_too(store, room, inputs) -> None:
    alone = train(store, inputs)
    both = train(store, inputs | {"image-corpus": put_corpus(store, room)})
    assert both.metadata.trained_on.endswith("and 6 pictures of an image corpus")
    assert both.path("weights.safetensors").read_bytes() != alone.path("weights.safetensors").read_bytes()


def test_a_damaged_picture_of_a_corpus_is_named(store, room, inputs) -> None:
    folder = store.private_folder()
    (folder / "broken.jpg").write_bytes(b"no picture")
    picture = ImageCorpus.Picture(name="broken", path="broken.jpg", scene="room", split="train")
    corpus = store.put(folder, "image-corpus", ImageCorpus(pictures=(picture,)))
    with pytest.raises(BadInputError, match=r"broken\.jpg is not a picture"):
        train(store, inputs | {"image-corpus": corpus})


def test_a_step_of_several_parts_takes_them_all(store, inputs) -> None:
    curves = {}
    for parts in (1, 2):
        prior = train(store, inputs, steps=2, curve_rows=2, parts=parts)
        rows = csv.DictReader(prior.path("training_curve.csv").read_text().splitlines())
        curves[parts] = [float(row["loss"]) for row in rows]
    # The first part of the first step is the same; the second is of other crops.
    other = 2 * curves[2][0] - curves[1][0]
    assert other > 0
    assert other != pytest.approx(curves[1][0], rel=1e-3)


# What the exporter uses of torch and onnxscript is old to torch itself.
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_the_faster_runtime_is_measured_and_recorded(store, inputs) -> None:
    prior = train(store, inputs, runtime="fastest", steps=1, channels_last=True)
    seconds = prior.metadata.query_seconds
    assert set(seconds) == {"torch", "onnxruntime"}
    assert prior.metadata.runtime == min(seconds, key=seconds.get)
    assert prior.metadata.onnx == "network.onnx"
    image, hole = torch.zeros(1, 3, 16, 16), torch.zeros(1, 1, 16, 16)
    hole[..., 4:12, 4:12] = 1
    z = torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    chosen, plain = open_prior(prior), load_prior(prior.path(prior.metadata.weights), prior.metadata.spec)
    here, there = (p.predict_noise(z, torch.full((1,), 0.5), image, hole) for p in (plain, chosen))
    torch.testing.assert_close(there, here, rtol=0, atol=1e-4)


def test_masks_over_nearly_everything_are_bad_input(store, room, inputs) -> None:
    covered = inputs | {"mask-set": put_masks(store, room, np.ones_like(room.object_masks))}
    with pytest.raises(BadInputError, match="none with half of its pixels known"):
        train(store, covered)


def test_a_frame_without_a_mask_is_bad_input(store, room, inputs) -> None:
    folder = store.private_folder()
    write_mask(folder / "masks" / "view_000.png", room.object_masks[0])
    view = MaskView(name="view_000", mask="masks/view_000.png", share=0.1)
    metadata = MaskSet(kind="per-view", task="inpaint", origin="imported", method="synthetic", views=(view,))
    with pytest.raises(BadInputError, match="view_001 has no mask"):
        train(store, inputs | {"mask-set": store.put(folder, "mask-set", metadata)})


@pytest.mark.parametrize(
    "wrong", [{"masks": {"own": 0.9}}, {"t_range": [0.9, 0.1]}, {"crop_share": [0.5, 1.5]}, {"steps": -1}]
)
def test_parameters_that_make_no_sense_are_configuration_errors(store, inputs, wrong) -> None:
    with pytest.raises(ConfigurationError):
        train(store, inputs, **wrong)
