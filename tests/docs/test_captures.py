"""docs/how-to/captures.md says what the code reads; `python -m tests.docs.test_captures` writes its tables anew."""

from pathlib import Path
from typing import get_args

from benchmarks.pages import fill_between

from inpaint3d.contracts.models.artifacts import Capture
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES, UNREADABLE_SUFFIXES
from inpaint3d.scene import plausibility
from inpaint3d.scene.pixel_io import MAX_DECODED_BYTES
from inpaint3d.stages.capture_ingest import config, video
from inpaint3d.stages.capture_ingest.layouts import LAYOUTS
from inpaint3d.stages.capture_ingest.lenses import FARTHEST_CENTRE, PARAMETERS, ROTATION_TOLERANCE, SUPPORTED
from inpaint3d.stages.pose_estimation import config as poses
from inpaint3d.stages.pose_estimation import gate

PAGE = Path(__file__).parents[2] / "docs/how-to/captures.md"


def build_parts() -> dict[str, str]:
    """Marker -> what belongs between it and its end."""
    rows = [f"| `{name}` | {x.marks} | {x.cameras} | {x.masks} | {x.truth} |" for name, x in LAYOUTS.items()]
    ways: dict[str, list[str]] = {}
    for suffix, way in UNREADABLE_SUFFIXES.items():
        ways.setdefault(way, []).append(f"`{suffix}`")
    unread = ["| not read | way out |", "|---|---|", *(f"| {', '.join(s)} | {way} |" for way, s in ways.items())]
    return {
        "layouts": "\n"
        + "\n".join(["| layout | by | cameras | masks | truth |", "|---|---|---|---|---|", *rows])
        + "\n",
        "suffixes": ", ".join(f"`{suffix}`" for suffix in sorted(PICTURE_SUFFIXES)),
        "unreadable": "\n" + "\n".join(unread) + "\n",
        "models": "\n" + ", ".join(SUPPORTED) + "\n",
    }


def fill_in(text: str) -> str:
    for name, part in build_parts().items():
        text = fill_between(text, name, part)
    return text


def test_the_page_is_what_the_code_does():
    assert PAGE.read_text() == fill_in(PAGE.read_text()), "run `python -m tests.docs.test_captures`"


def test_every_layout_is_on_the_page_and_in_the_contract():
    assert set(LAYOUTS) == set(get_args(config.Layout))
    assert set(LAYOUTS) == set(get_args(Capture.model_fields["layout"].annotation))


def test_figures_of_the_page_are_those_of_the_code():
    text = PAGE.read_text()
    assert f"more than {MAX_DECODED_BYTES // 2**20} MiB decoded" in text
    assert f"axes within\n{ROTATION_TOLERANCE}" in text
    assert f"more than {FARTHEST_CENTRE:g} picture sizes from the middle" in text
    assert f"light of {video.WHITE} cd/m²" in text
    assert set(PARAMETERS) == set(SUPPORTED)
    limits = poses.Config()
    assert f"less than {limits.min_agreement:.0%}".replace("%", " %") in text
    assert f"less than {limits.min_view_agreement:.0%}".replace("%", " %") in text
    assert f"within {limits.largest_epipolar_px:g} px per 1000" in text
    assert f"more than {gate.FAR:g} times as far" in text
    assert f"fewer than {gate.BLANK} features" in text
    assert f"{gate.DEGENERATE_SHARE:.0%} of the matching pairs".replace("%", " %") in text
    assert f"or {gate.FLAT_SHARE:.0%} are flat".replace("%", " %") in text
    assert f"a median of fewer than {gate.FEW_FEATURES} features" in text


def test_figures_of_what_is_doubted_are_those_of_the_code():
    text = (PAGE.parent / "run-your-own-photos.md").read_text()
    gain = plausibility.LEAST_GAIN_DB
    assert f"less than {gain[plausibility.MEAN_COLOUR]:g} dB over the mean colour" in text
    assert f"{-gain[plausibility.WARPED]:g} dB under the nearest photo" in text
    shares = {
        "off by more than {}": plausibility.LARGEST_DEPTH_ERROR,
        "more than {} of the light": plausibility.LARGEST_FLOATERS,
        "more than {} of the pictures": plausibility.LARGEST_HOLE,
    }
    for words, share in shares.items():
        assert words.format(f"{share:.0%}".replace("%", " %")) in text
    assert f"agree by less than {plausibility.LEAST_CONSISTENCY} (IoU)" in text
    assert f"less than {plausibility.LEAST_COMPLETION_DB:g} dB between them" in text


if __name__ == "__main__":
    PAGE.write_text(fill_in(PAGE.read_text()))
