import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from inpaint3d.contracts.errors import ArtifactError, BadInputError, ConfigurationError
from inpaint3d.contracts.models.artifacts import DiffusionPrior, ImageCorpus
from inpaint3d.contracts.models.documents import load_yaml
from inpaint3d.contracts.models.manifest import MANIFEST, Manifest
from inpaint3d.contracts.store import FolderStore, load_artifact
from inpaint3d.diffusion import parallel
from inpaint3d.diffusion.io import open_prior
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.diffusion_training.config import OF_LEARNING, Config
from inpaint3d.stages.diffusion_training.corpus import write_corpus
from inpaint3d.stages.diffusion_training.pretrain import pretrain

TINY = load_yaml(Path(__file__).parent / "tiny.yaml")[0] | {"parts": 2, "steps": 4, "curve_rows": 2}


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    noise = np.random.default_rng(0)
    for i in range(8):
        write_png(tmp_path / "pictures" / f"{i}.png", noise.integers(0, 256, (20, 24, 3), np.uint8))
    write_corpus(tmp_path / "pictures", tmp_path / "corpus", held_out=0.4)
    return tmp_path / "corpus"


def curve(folder: Path) -> list[list[float]]:
    rows = list(csv.reader((folder / "prior" / "training_curve.csv").read_text().splitlines()))
    return [[float(value) for value in row] for row in rows[1:]]


@pytest.mark.slow
def test_torchrun_learns_what_one_process_does(corpus: Path, tmp_path: Path) -> None:
    pretrain([corpus], tmp_path / "one", Config.model_validate(TINY), seed=0)
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(TINY))
    torchrun = [sys.executable, "-W", "ignore", "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    module = ["-m", "inpaint3d.stages.diffusion_training.pretrain", str(corpus), str(tmp_path / "two")]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": "lo"}
    command = [*torchrun, *module, "--config", str(tmp_path / "config.yaml")]
    subprocess.run(command, check=True, timeout=180, env=environment, stdout=subprocess.DEVNULL)
    # Sums in another order, four steps long; the table has six digits.
    np.testing.assert_allclose(curve(tmp_path / "two"), curve(tmp_path / "one"), rtol=1e-4)


def test_what_it_writes_is_a_prior_that_a_run_takes(corpus: Path, tmp_path: Path) -> None:
    pretrain([corpus], tmp_path / "out", Config.model_validate(TINY), seed=0)
    folder, store = tmp_path / "out" / "prior", FolderStore(tmp_path / "store")
    digest = store.adopt(folder, Manifest.model_validate_json((folder / MANIFEST).read_bytes()))
    prior = store.open(digest, DiffusionPrior)
    assert prior.metadata.steps == 4
    assert "hole_psnr_sample" in prior.metadata.held_out
    assert open_prior(prior).size == 16


def test_all_corpora_are_learnt_from(corpus: Path, tmp_path: Path) -> None:
    """A second one, of black pictures, makes it another prior."""
    for i in range(12):
        write_png(tmp_path / "black" / f"{i}.png", np.zeros((20, 24, 3), np.uint8))
    write_corpus(tmp_path / "black", tmp_path / "other", held_out=0.4)
    pretrain([corpus], tmp_path / "one", Config.model_validate(TINY), seed=0)
    pretrain([corpus, tmp_path / "other"], tmp_path / "two", Config.model_validate(TINY), seed=0)
    one, two = (
        load_artifact(tmp_path / name / "prior", "diffusion-prior@1", DiffusionPrior).metadata
        for name in ("one", "two")
    )
    pictures = [
        load_artifact(folder, "image-corpus@1", ImageCorpus).metadata.pictures
        for folder in (corpus, tmp_path / "other")
    ]
    learnt = [sum(p.split == "train" for p in some) for some in pictures]
    assert one.trained_on == f"{learnt[0]} pictures of an image corpus"
    assert two.trained_on == f"{sum(learnt)} pictures of 2 image corpora"
    assert curve(tmp_path / "one") != curve(tmp_path / "two")


def test_it_goes_on_from_another_priors_weights(corpus: Path, tmp_path: Path) -> None:
    pretrain([corpus], tmp_path / "first", Config.model_validate(TINY), seed=0)
    first = load_artifact(tmp_path / "first" / "prior", "diffusion-prior@1", DiffusionPrior)
    none = Config.model_validate({name: TINY[name] for name in TINY.keys() - set(OF_LEARNING)} | {"steps": 0})
    pretrain([corpus], tmp_path / "second", none, seed=1, start=first.root)
    second = load_artifact(tmp_path / "second" / "prior", "diffusion-prior@1", DiffusionPrior)
    assert second.metadata.start == first.digest
    assert second.path("weights.safetensors").read_bytes() == first.path("weights.safetensors").read_bytes()
    (first.root / "weights.safetensors").write_bytes(b"torn")
    with pytest.raises(ArtifactError, match="is not what was written"):
        pretrain([corpus], tmp_path / "third", none, seed=1, start=first.root)


def test_what_cannot_be_learnt_from_is_named(corpus: Path, tmp_path: Path, monkeypatch) -> None:
    config = Config.model_validate(TINY)
    with pytest.raises(ConfigurationError, match="nowhere holds no artifact"):
        pretrain([tmp_path / "nowhere"], tmp_path / "out", config, seed=0)
    write_corpus(tmp_path / "pictures", tmp_path / "all", held_out=0.0)
    with pytest.raises(BadInputError, match="8 pictures to learn from and 0 held out"):
        pretrain([tmp_path / "all"], tmp_path / "out", config, seed=0)
    monkeypatch.setattr(parallel, "ranks", lambda: 3)
    with pytest.raises(ConfigurationError, match="2 parts of a batch cannot be shared equally by 3 ranks"):
        pretrain([corpus], tmp_path / "out", config, seed=0)
