import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.artifact import reduce_camera, stub_weights, write_curve, write_view, write_views
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.io import load_field
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.image_io import read_image
from inpaint3d.scene.map_io import read_exr

TINY = FieldSpec(
    grid=GridSpec(levels=3, coarsest=4, finest=32, log2_table=8, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(8,), samples=6, density_width=8, bottleneck=3, view_width=8, view_layers=2, glo=2, glo_views=3,
)  # fmt: skip


@pytest.mark.parametrize(
    "spec", [TINY, TINY.model_copy(update={"glo": 0}), TINY.model_copy(update={"view_layers": 0}), FieldSpec()]
)
def test_stub_weights_are_those_of_the_field(spec: FieldSpec, tmp_path: Path) -> None:
    save_file(stub_weights(spec), tmp_path / "weights.safetensors")
    field = load_field(tmp_path / "weights.safetensors", spec)
    assert field.spec == spec


def test_importing_it_takes_no_torch() -> None:
    code = "import sys, inpaint3d.radiance.artifact; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_views_are_rendered_at_the_asked_size_and_repeat(tmp_path: Path) -> None:
    camera = Camera(40, 40, 24, 18, 48, 36, look_at((0.8, 0, 0.3), (0, 0, 0)))
    ticks = []
    (view,) = write_views(
        tmp_path, RadianceField(TINY, 0), [("a", camera)], longest_side=24, tick=lambda d, t: ticks.append((d, t))
    )
    maps = read_exr(tmp_path / view.maps)
    assert set(maps) == {"depth.Z", "median.Z", "opacity.A", "normal.X", "normal.Y", "normal.Z"}
    assert maps["depth.Z"].shape == (18, 24)
    assert read_image(tmp_path / view.picture).shape == (18, 24, 3)
    assert ticks == [(0, 1)]
    first = (tmp_path / view.maps).read_bytes()
    write_views(tmp_path, RadianceField(TINY, 0), [("a", camera)], longest_side=24)
    assert (tmp_path / view.maps).read_bytes() == first


def test_a_camera_is_never_enlarged() -> None:
    camera = Camera(40, 40, 24, 18, 48, 36, look_at((0.8, 0, 0.3), (0, 0, 0)))
    assert (reduce_camera(camera, 480).width, reduce_camera(camera, 480).height) == (48, 36)
    assert reduce_camera(camera, 12).fx == 10


def test_surfaces_have_normals_and_the_rest_none(tmp_path: Path) -> None:
    camera = Camera(4, 4, 3, 2, 6, 4, look_at((0.8, 0, 0), (0, 0, 0)))
    wall, opacity = np.ones((4, 6), np.float32), np.ones((4, 6), np.float32)
    opacity[:, 4:] = 0.2
    maps = {"rgb": np.ones((4, 6, 3), np.float32), "depth": wall, "median_depth": wall, "opacity": opacity}
    found = read_exr(tmp_path / write_view(tmp_path, "a", camera, maps).maps)
    normal = np.stack([found[f"normal.{axis}"] for axis in "XYZ"], -1)
    np.testing.assert_allclose(normal[:, :4], np.tile([1.0, 0.0, 0.0], (4, 4, 1)), atol=1e-6)
    assert not normal[:, 4:].any()


def test_view_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    flat = np.ones((4, 4), np.float32)
    camera = Camera(4, 4, 2, 2, 4, 4, look_at((0.8, 0, 0.3), (0, 0, 0)))
    maps = {"rgb": np.ones((4, 4, 3), np.float32), "depth": flat * np.nan, "median_depth": flat, "opacity": flat}
    with pytest.raises(NonFiniteError, match="the render of view a is not finite: depth in 16 numbers"):
        write_view(tmp_path, "a", camera, maps)


def test_curve_leaves_cells_empty_where_nothing_was_rendered(tmp_path: Path) -> None:
    write_curve(tmp_path, [[10, 5000, 0.25, float("nan")], [20, 10000, 0.125, 21.5]])
    with (tmp_path / "learning_curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [r["psnr"] for r in rows] == ["", "21.5"]
    assert rows[1]["rays"] == "10000"
