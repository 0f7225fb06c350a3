"""Files that say something strange: what is read is finite and in known units, or refused by name."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from inpaint3d.contracts.errors import ArtifactError, BadInputError, ConfigurationError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import PaintedView, PaintedViews
from inpaint3d.contracts.models.canonical import canonical_json
from inpaint3d.contracts.store import FolderStore
from inpaint3d.scene.capture_io import load_points, write_points
from inpaint3d.scene.finite import find_non_finite
from inpaint3d.scene.image_io import read_image, read_mask, read_opaque, write_png
from inpaint3d.scene.map_io import write_exr
from inpaint3d.scene.paintings import read_painting
from inpaint3d.scene.synthetic import synthetic_scene
from tests.stability.catalogue import hard_case

FILES = "Files"


def write_float(path: Path, pixels: np.ndarray, channels: Sequence[str] = (), **attributes: str) -> None:
    """An EXR or TIFF of any numbers, as other programs write them; ours refuses to write what is not finite."""
    import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses

    h, w, c = pixels.shape
    output = oiio.ImageOutput.create(str(path))
    spec = oiio.ImageSpec(w, h, c, oiio.FLOAT)
    if channels:
        spec.channelnames = tuple(channels)
    for name, value in attributes.items():
        spec.attribute(f"oiio:{name}", value)
    output.open(str(path), spec)
    output.write_image(np.ascontiguousarray(pixels, np.float32))
    output.close()


@hard_case(
    FILES,
    plain="NaN > 0.5 is False: a mask of NaN is an empty mask",
    ours="refused with the count",
    swept="NaN, inf in one pixel and in all",
    told="`mask PATH has COUNT pixels that are not finite; save it as black and white` (exit code 3)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("everywhere", [True, False])
def test_masks_that_are_not_finite(tmp_path: Path, value: float, everywhere: bool) -> None:
    mask = np.zeros((8, 8, 1))
    mask[slice(None) if everywhere else 3, 2:4] = value
    write_float(tmp_path / "m.exr", mask)
    with pytest.raises(BadInputError, match=rf"mask .*m.exr has {16 if everywhere else 2} pixels that are not finite"):
        read_mask(tmp_path / "m.exr")


@hard_case(
    FILES,
    plain="linear light in other units is clipped: 94 % white, or black, without a word",
    ours="refused with the range that was found",
    swept="light of 1e-6 to 1e6 times the usual, negative light; NaN and inf in one pixel",
    told="`PATH holds linear light from 0.5 to 900, and 94% of it is white; export it in units in which white is 1` "
    "(exit code 3)",
)
@pytest.mark.parametrize("scale", [1e-6, 1e-4, 0.05, 1.0, 1.5, 50.0, 1e6, -1.0, math.nan, math.inf])
def test_linear_light_in_other_units(tmp_path: Path, scale: float) -> None:
    light = np.random.default_rng(0).random((16, 16, 3)) * 0.9
    if math.isfinite(scale):
        light *= scale
    else:
        light[3, 4] = scale
    write_float(tmp_path / "p.exr", light)
    if scale in (0.05, 1.0, 1.5):
        assert 0 < read_image(tmp_path / "p.exr").max() <= 1
    else:
        with pytest.raises(BadInputError, match=r"p\.exr (holds linear light from|has 1 pixels that are not finite)"):
            read_image(tmp_path / "p.exr")


@hard_case(
    FILES,
    plain="NaN > 0.5 is False: what has an alpha of NaN is transparent, no evidence",
    ours="refused with the count",
    swept="NaN, inf in one pixel and in all",
    told="`PATH has COUNT pixels whose alpha is not finite; export it again without them` (exit code 3)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("everywhere", [True, False])
def test_alpha_that_is_not_finite(tmp_path: Path, value: float, everywhere: bool) -> None:
    picture = np.ones((8, 8, 4))
    picture[slice(None) if everywhere else 3, 2:4, 3] = value
    write_float(tmp_path / "p.exr", picture, "RGBA")
    with pytest.raises(BadInputError, match=rf"p.exr has {16 if everywhere else 2} pixels whose alpha is not finite"):
        read_opaque(tmp_path / "p.exr")


@hard_case(
    FILES,
    plain="paint of NaN or of other units reaches every pixel that the completion takes from it",
    ours="refused, under the name that the file has in the user's folder",
    swept="NaN, inf and light of 1e6 in a painted picture, in its mask",
    told="`pictures/a.exr has COUNT pixels that are not finite; export it again without them` (exit code 3)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e6])
@pytest.mark.parametrize("file", ["pictures/a.exr", "masks/a.exr"])
def test_paintings_that_are_not_finite(tmp_path: Path, value: float, file: str) -> None:
    store = FolderStore(tmp_path / "store")
    folder = store.private_folder()
    for path in ("pictures/a.exr", "masks/a.exr"):
        (folder / path).parent.mkdir()
        write_float(folder / path, np.full((8, 8, 3), value if path == file else 0.75))
    view = PaintedView(name="a", picture="pictures/a.exr", mask="masks/a.exr")
    painted = store.open(store.put(folder, "painted-views", PaintedViews(views=(view,))), PaintedViews)
    if file == "masks/a.exr" and value == 1e6:
        assert read_painting(painted, view).mask.all()
        return
    with pytest.raises(BadInputError, match=rf"^(mask )?{file} (has 64 pixels that are not finite|holds linear light)"):
        read_painting(painted, view)


def test_black_linear_pictures_are_pictures(tmp_path: Path) -> None:
    write_float(tmp_path / "p.exr", np.zeros((4, 4, 3)))
    assert read_image(tmp_path / "p.exr").max() == 0


@hard_case(
    FILES,
    plain="a NaN has no code of 8 bits: it is written as any",
    ours="refused before anything is written",
    swept="NaN, inf, -inf in one number of a PNG, of an EXR",
    told="`PATH: values that are not finite: NAME (1, the first at [ROW, COLUMN, CHANNEL])` (exit code 1)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("kind", ["png", "exr"])
def test_pictures_that_are_not_finite_are_not_written(tmp_path: Path, value: float, kind: str) -> None:
    picture = np.zeros((4, 4, 3))
    picture[1, 2, 0] = value
    with pytest.raises(ValueError, match="not finite"):
        write_png(tmp_path / "p.png", picture) if kind == "png" else write_exr(
            tmp_path / "p.exr", {"a": picture[..., 0]}
        )
    assert not list(tmp_path.iterdir())


@hard_case(
    FILES,
    plain="a sparse point of NaN reaches every loss along its ray",
    ours="points are looked at when they are read",
    swept="NaN and inf in a position, an error, a track",
    told="`PATH: numbers that are not finite: ARRAY (1, the first at [ROW, AXIS]); run pose-estimation` (exit code 3)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["xyz", "error", "track_xy"])
def test_points_that_are_not_finite(tmp_path: Path, value: float, name: str) -> None:
    write_points(tmp_path / "p.safetensors", synthetic_scene(views=3).points)
    arrays = load_file(tmp_path / "p.safetensors")
    arrays[name].reshape(-1)[-1] = value
    save_file(arrays, tmp_path / "p.safetensors")
    with pytest.raises(ArtifactError, match=rf"not finite: {name} \(1, the first at \[{len(arrays[name]) - 1}"):
        load_points(tmp_path / "p.safetensors")


@hard_case(
    FILES,
    plain="-1 as a view is the last one, offsets beyond the end are an error of numpy, tracks of others count as own",
    ours="tracks are divided among the points, or refused",
    swept="a view of -1, offsets that fall, end early, late, or are one too few; colours of fewer points",
    told="`PATH: COUNT sightings of views from -1 on do not fall to COUNT points by track_offsets ...; run "
    "pose-estimation` (exit code 3)",
)
@pytest.mark.parametrize("broken", ["view", "fall", "early", "late", "few", "colours"])
def test_tracks_of_other_points(tmp_path: Path, broken: str) -> None:
    path = tmp_path / "p.safetensors"
    write_points(path, synthetic_scene(views=3).points)
    arrays = load_file(path)
    offsets = arrays["track_offsets"]
    if broken == "view":
        arrays["track_frame"][2] = -1
    elif broken == "fall":
        offsets[1:3] = offsets[2:0:-1].copy()
    elif broken in ("early", "late"):
        offsets[-1] += 1 if broken == "late" else -1
    else:
        name = "track_offsets" if broken == "few" else "rgb"
        arrays[name] = arrays[name][1:]
    save_file(arrays, path)
    with pytest.raises(ArtifactError, match=r"p\.safetensors: \d+ sightings of views from -?\d on do not fall to"):
        load_points(path)


def test_codes_of_floats_are_colours_of_a_picture(tmp_path: Path) -> None:
    """Files of floats that say that they are sRGB may overshoot."""
    pixels = np.full((4, 4, 3), 1.5)
    pixels[0] = -0.5
    write_float(tmp_path / "p.tif", pixels, ColorSpace="sRGB")
    found = read_image(tmp_path / "p.tif")
    assert (found[0] == 0).all()
    assert (found[1:] == 1).all()


def test_no_points_are_points(tmp_path: Path) -> None:
    points = synthetic_scene(views=3).points
    write_points(tmp_path / "p.safetensors", points.select(np.zeros(len(points), bool)))
    assert len(load_points(tmp_path / "p.safetensors")) == 0


@hard_case(
    FILES,
    plain="one inf in a row, and a run of hours ends with `cannot be written as JSON`",
    ours="the figure is left out and counted by its place",
    swept="NaN, inf, -inf in a series and in progress",
    told="`non_finite: {series.NAME.COLUMN: COUNT}` in the report",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_figures_that_json_has_no_word_for(tmp_path: Path, value: float) -> None:
    events = []
    ctx = Context(seed=0, device="cpu", threads=1, work=tmp_path, emit=lambda event, **v: events.append(v))
    ctx.record("curve", step=1, loss=value, psnr=20.0)
    ctx.record("curve", step=2, loss=value)
    ctx.progress(1, 1, "x", loss=value)
    assert ctx.non_finite == {"series.curve.loss": 2, "progress.loss": 1}
    (first, second) = ctx.timings()["series"]["curve"]
    assert first["psnr"] == 20.0
    assert "loss" not in first
    assert second["step"] == 2
    assert "loss" not in events[0]
    canonical_json(ctx.timings())
    with pytest.raises(ConfigurationError, match="cannot be written as JSON"):
        canonical_json({"x": value})


@hard_case(
    FILES,
    plain="a sum of finite numbers may overflow, and one of inf and -inf is NaN",
    ours="sums are only a first look",
    swept="float16 to float64, largest numbers, denormal ones, NaN, inf, opposite inf, empty, whole numbers",
)
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize("value", [0.0, -1.0, "largest", "tiny", math.nan, math.inf])
def test_what_is_not_finite_is_found(dtype, value: float | str) -> None:
    limits = np.finfo(dtype)
    number = {"largest": limits.max, "tiny": limits.smallest_subnormal}.get(value, value)
    array = np.full((5, 7), number, dtype)
    array[0, 0] = 1
    array[4, 6] = -number
    found = find_non_finite({"a": array, "whole": np.ones(3, int), "none": np.empty((0, 2), dtype)})
    if isinstance(value, float) and not math.isfinite(value):
        assert [str(f) for f in found] == ["a (34, the first at [0, 1])"]
    else:
        assert found == []
