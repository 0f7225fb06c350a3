"""Nothing under a mask reaches the prior or the joint optimisation.

With the cameras, the effect plan and the masks held fixed, the masked pixels of every frame are repainted in a marker
colour. Not one byte of the prior, of the reconstruction without prior, of the completed views or of the joint field may
change.
"""

import shutil

import numpy as np
import pytest

from inpaint3d.contracts.kit.upstream import Upstream, invoke
from inpaint3d.contracts.models.artifacts import MaskSet, PosedCapture
from inpaint3d.contracts.models.documents import load_yaml
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.scene.image_io import read_image, read_mask, write_png
from tests.conftest import REPOSITORY

MARKER = np.array([1.0, 0.0, 1.0], np.float32)
LEARNING = ("diffusion-training", "masked-reconstruction", "view-completion", "joint-optimization")


def repainted(store: Store, posed_digest: str, masks_digest: str) -> str:
    """The posed capture with the pixels under the masks in the marker colour."""
    posed = store.open(posed_digest, PosedCapture)
    masks = store.open(masks_digest, MaskSet)
    folder = store.private_folder()
    shutil.copytree(posed.root, folder, dirs_exist_ok=True)
    (folder / "artifact.json").unlink()
    covered = 0
    for view in masks.metadata.views:
        frame = next(f for f in posed.metadata.frames if f.name == view.name)
        image = read_image(posed.path(frame.path))
        mask = read_mask(masks.path(view.mask))
        covered += int(mask.sum())
        (folder / frame.path).unlink()
        write_png(folder / frame.path, np.where(mask[..., None], MARKER, image))
    assert covered > 100, "the test needs a hole"
    return store.put(folder, "posed-capture", posed.metadata)


def steps_of(tiny: dict) -> dict:
    """As many steps as the stage's own test takes: the pipeline's are minutes of joint fitting, none of the prior."""
    return {"steps": tiny["steps"]} if "steps" in tiny else {}


@pytest.mark.slow
def test_marker_colour_under_the_mask_changes_nothing(tmp_path):
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml")
    store = FolderStore(tmp_path / "store")
    upstream = Upstream(pipeline, "joint-optimization", store)
    posed, masks = upstream.produced["pose-estimation.posed-capture"], upstream.produced["mask-authoring.mask-set"]
    digests = []
    for capture in (posed, repainted(store, posed, masks)):
        made = {**upstream.produced, "pose-estimation.posed-capture": capture}
        for node in LEARNING:
            tiny = load_yaml(REPOSITORY / pipeline.nodes[node].stage / "tests" / "tiny.yaml")[0]
            upstream.produced = made
            parameters = {**tiny, **pipeline.nodes[node].parameters, **steps_of(tiny)}
            result = invoke(pipeline.stages[node], store, upstream.inputs_of(node), parameters=parameters)
            assert result.code == 0, result.error + result.stderr
            made |= {f"{node}.{port}": digest for port, digest in result.outputs.items()}
        digests.append({port: digest for port, digest in made.items() if port.split(".")[0] in LEARNING})
    assert digests[0] == digests[1]
