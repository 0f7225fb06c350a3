"""docs/how-to/captures.md says what the code reads; `python -m tests.docs.test_captures` writes its tables anew."""

import re
from pathlib import Path
from typing import get_args

from inpaint3d.contracts.models.artifacts import Capture
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES, UNREADABLE_SUFFIXES
from inpaint3d.scene.image_io import MAX_DECODED_BYTES
from inpaint3d.stages.capture_ingest import config
from inpaint3d.stages.capture_ingest.layouts import LAYOUTS
from inpaint3d.stages.capture_ingest.lenses import PARAMETERS, ROTATION_TOLERANCE, SUPPORTED

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
        text = re.sub(rf"(<!-- {name} -->).*?(<!-- /{name} -->)", lambda m, p=part: m[1] + p + m[2], text, flags=re.S)
    return text


def test_the_page_is_what_the_code_does():
    assert PAGE.read_text() == fill_in(PAGE.read_text()), "run `python -m tests.docs.test_captures`"


def test_every_layout_is_on_the_page_and_in_the_contract():
    assert set(LAYOUTS) == set(get_args(config.Layout))
    assert set(LAYOUTS) == set(get_args(Capture.model_fields["layout"].annotation))


def test_figures_of_the_page_are_those_of_the_code():
    text = PAGE.read_text()
    assert f"more than {MAX_DECODED_BYTES // 2**20} MiB decoded" in text
    assert f"axes within {ROTATION_TOLERANCE}" in text
    assert set(PARAMETERS) == set(SUPPORTED)


if __name__ == "__main__":
    PAGE.write_text(fill_in(PAGE.read_text()))
