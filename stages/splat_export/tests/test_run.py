"""What the stage does, on what the stubs before it write."""

from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.kit.upstream import Upstream, invoke
from inpaint3d.contracts.models.artifacts import SplatScene
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore

REPOSITORY = Path(__file__).parents[3]
FEW = {"splats": 300, "steps": 2, "render_longest_side": 16, "opaque": 0.01, "held_out_views": 1}


@pytest.fixture(scope="module")
def upstream(tmp_path_factory):
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml").under(None)
    return Upstream(pipeline, "splat-export", FolderStore(tmp_path_factory.mktemp("store")))


def exported(upstream, *, without=(), **parameters):
    inputs = {port: digest for port, digest in upstream.inputs_of("splat-export").items() if port not in without}
    spec = upstream.pipeline.stages["splat-export"]
    return invoke(spec, upstream.store, inputs, parameters=FEW | parameters)


def opened(upstream, result):
    return upstream.store.open(result.outputs["splat-scene"], SplatScene)


def test_the_formats_that_are_asked_for_are_written_and_scored(upstream):
    scene = opened(upstream, exported(upstream, formats=["ply", "spz"]))
    assert scene.metadata.files == {"ply": "splats.ply", "spz": "splats.spz"}
    assert all((scene.root / file).stat().st_size > 1000 for file in scene.metadata.files.values())
    assert 100 <= scene.metadata.splats <= 300
    assert scene.metadata.fidelity is not None
    assert scene.metadata.fidelity.photos == 1
    assert np.isfinite(scene.metadata.fidelity.psnr)


def test_without_completed_views_the_hole_is_the_fields(upstream):
    with_views = opened(upstream, exported(upstream))
    without = opened(upstream, exported(upstream, without=("completed-views",)))
    assert without.metadata.splats == with_views.metadata.splats
    plys = [(scene.root / "splats.ply").read_bytes() for scene in (with_views, without)]
    assert plys[0] != plys[1]


@pytest.mark.parametrize(("parameters", "word"), [({"formats": []}, "formats"), ({"splats": 3}, "splats")])
def test_parameters_out_of_range_are_refused(upstream, parameters, word):
    result = exported(upstream, **parameters)
    assert result.code == 2
    assert word in result.error
