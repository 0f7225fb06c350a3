"""What is prepared for a GPU, tried on the processor: a machine that is lent for minutes leaves no time for that."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
from benchmarks.gpu import pieces, start
from benchmarks.gpu.pack import pack_corpus
from benchmarks.gpu.results import Results

from inpaint3d.contracts.models.artifacts import DiffusionPrior, ImageCorpus
from inpaint3d.contracts.store import load_artifact
from inpaint3d.diffusion.io import open_prior
from inpaint3d.scene.image_io import write_png
from tests.conftest import REPOSITORY


def test_the_whole_run_goes_through_on_the_processor(tmp_path: Path) -> None:
    """Tiny sizes, time for all; every part, every figure, and the prior that it leaves is one that a run takes."""
    options = ["--device", "cpu", "--tiny", "--minutes", "30", "--out", str(tmp_path / "out"), "--piece-mib", "0.2"]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.gpu", *options], cwd=REPOSITORY, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    assert list(found) == ["machine", "correctness", "rates", "prior"]
    failed = {name: value for part in found.values() for name, value in part.items() if "failed" in str(value)}
    assert not failed
    assert all(check.get("ok", True) for check in found["correctness"].values())
    assert len(list((tmp_path / "out").glob("weights.safetensors.*"))) == len(found["prior"]["pieces"]) > 1
    subprocess.run(
        [sys.executable, "-m", "benchmarks.gpu.pieces", str(tmp_path / "out"), str(tmp_path / "prior")],
        cwd=REPOSITORY, check=True, capture_output=True,
    )  # fmt: skip
    prior = load_artifact(tmp_path / "prior", "diffusion-prior@1", DiffusionPrior)
    assert prior.metadata.steps == found["prior"]["trained"]["steps"] > 0
    assert prior.metadata.held_out["crops"] == 2
    assert prior.metadata.held_out["hole_psnr_sample"] == found["prior"]["table"]["sample"]["hole_psnr"]
    assert open_prior(prior).size == 32


def test_what_fails_takes_nothing_from_the_rest(tmp_path: Path) -> None:
    results = Results(tmp_path / "results.json", "rates", until=float("inf"))
    results.attempt("broken", lambda: 1 // 0)
    results.attempt("whole", lambda: {"value": 1})
    Results(tmp_path / "results.json", "prior", until=0.0).attempt("late", lambda: 1, needs_s=1.0)
    found = json.loads((tmp_path / "results.json").read_text())
    assert "ZeroDivisionError" in found["rates"]["broken"]["failed"]
    assert found["rates"]["whole"]["value"] == 1
    assert "skipped" in found["prior"]["late"]


def test_a_corpus_is_packed_into_the_room_there_is(tmp_path: Path) -> None:
    """Small enough, as many as fit, held out by their names as in any corpus."""
    noise = np.random.default_rng(0)
    for i in range(30):
        write_png(tmp_path / "photos" / f"{i}.png", noise.integers(0, 256, (90, 120, 3), np.uint8))
    room = 60_000.0
    count = pack_corpus([tmp_path / "photos"], tmp_path / "corpus", room, 48, 0.2)
    corpus = load_artifact(tmp_path / "corpus", "image-corpus@1", ImageCorpus)
    files = [corpus.path(picture.path) for picture in corpus.metadata.pictures]
    used = sum(file.stat().st_size for file in files)
    assert 1 < count == len(files) < 30
    assert room / 2 < used < room
    assert {cv2.imread(str(file)).shape for file in files} == {(48, 64, 3)}


def test_pieces_join_to_what_was_cut(tmp_path: Path) -> None:
    data = np.random.default_rng(0).bytes(1000)
    names = pieces.write_pieces(tmp_path, "weights", data, 300)
    assert [len((tmp_path / name).read_bytes()) for name in names] == [300, 300, 300, 100]
    assert pieces.join_pieces(tmp_path, "weights") == data


def test_the_machine_is_asked_what_it_lacks() -> None:
    assert start.is_installed("numpy")
    assert start.is_installed("pydantic_core")
    assert not start.is_installed("no_such_package_as_this")
