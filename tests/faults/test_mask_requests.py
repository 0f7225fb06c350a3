"""Mask requests with a mistake in them: each is told by file, line and field before any stage runs; nothing is kept."""

import copy
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.intake import take_mask_request, take_segmenter
from inpaint3d.orchestrator.segmenter import recognise
from tests.faults.fuzz import mutate
from tests.sam_networks import write_networks

SPHERE = {"kind": "sphere", "centre": [0, 0, 0.5], "radius": 0.3}
CLICK = {"kind": "sphere", "surface": {"view": "a", "at": [10, 20], "frame_size": [64, 48]}, "radius": 0.2}
BOX = {"kind": "box", "centre": [0, 0, 0], "size": [1, 1, 1], "yaw_deg": 10}
OBJECT = {"kind": "object", "view": "a", "points": [[10, 20], [12, 30]], "background": [[1, 2]],
          "box": [5, 6, 40, 41], "frame_size": [64, 48]}  # fmt: skip
SCRIBBLE = {"kind": "scribble", "view": "a", "path": [[10, 20], [30, 20]], "thickness": 0.1}
OUTPAINT = {"kind": "outpaint", "distance": 1.0, "radius": 0.5}
UNION = {"kind": "union", "of": [SPHERE, OBJECT]}
DIFFERENCE = {"kind": "difference", "of": OBJECT, "minus": [BOX]}
OBJECTS = {"kind": "objects", "named": {"cup": OBJECT, "book": SPHERE}, "remove": ["cup"]}
GOOD = [SPHERE, CLICK, BOX, OBJECT, SCRIBBLE, OUTPAINT, UNION, DIFFERENCE, OBJECTS]

BY_HAND = {
    "nothing to find": {"kind": "object", "view": "a"},
    "a background point on a point": OBJECT | {"background": [[10, 20]]},
    "a point beside the picture": OBJECT | {"points": [[64, 20]]},
    "a point left of the picture": SCRIBBLE | {"path": [[-1, 3]]},
    "a point beside the box": OBJECT | {"points": [[2, 2]]},
    "an empty box": OBJECT | {"box": [40, 6, 40, 41]},
    "a box that leaves the picture": OBJECT | {"box": [5, 6, 70, 41]},
    "one view twice": OBJECT | {"other_views": [{"view": "a", "points": [[3, 3]]}]},
    "two places for one sphere": SPHERE | {"surface": CLICK["surface"]},
    "no place for a box": {"kind": "box", "size": [1, 1, 1]},
    "a union of nothing": {"kind": "union", "of": []},
    "a difference that takes nothing": {"kind": "difference", "of": SPHERE, "minus": []},
    "outpainting in a union": {"kind": "union", "of": [OUTPAINT]},
    "an object of no name": {"kind": "objects", "named": {}},
    "a name that is a path": {"kind": "objects", "named": {"../cup": SPHERE}},
    "an unknown object removed": OBJECTS | {"remove": ["plate"]},
    "nothing removed": OBJECTS | {"remove": []},
    "a kind that is none": {"kind": "cylinder", "radius": 1},
}
WRONG: list[Any] = [float("nan"), float("inf"), {"x": 1}, [[1, 2, 3]]]
"""What no field takes."""
NEEDED = {"kind", "view", "size", "of", "minus", "named", "mask", "at"}


def list_places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every key and item of a document, the inner ones too."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*path, key)
        yield from list_places(inner, (*path, key))


def spoil(good: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """A good request with one field of a wrong kind, unknown, or left out where it has to be."""
    made = copy.deepcopy({"mask": good, "dilate": 0.01})
    *outer, last = rng.choice(list(list_places(made)))
    at: Any = made
    for key in outer:
        at = at[key]
    how = rng.randrange(3)
    if how == 0 and isinstance(at, dict) and "named" not in outer[-1:]:
        at[f"{last}s"] = at.pop(last)  # a typo
    elif how == 1 and last in NEEDED:
        del at[last]
    else:
        at[last] = rng.choice(WRONG)
    return made


def make_requests(count: int) -> list[dict[str, Any]]:
    rng = random.Random(0)
    spoilt = [spoil(GOOD[i % len(GOOD)], rng) for i in range(count)]
    return [{"mask": mask} for mask in BY_HAND.values()] + spoilt


@pytest.mark.parametrize("good", GOOD, ids=lambda mask: mask["kind"])
def test_requests_written_by_hand_are_taken(good, tmp_path):
    store = FolderStore(tmp_path / "store")
    (tmp_path / "request.yaml").write_text(yaml.safe_dump({"mask": good}))
    assert store.is_whole(take_mask_request(store, tmp_path / "request.yaml"))


def test_a_hundred_requests_with_a_mistake_are_each_told_what_it_is(tmp_path):
    store = FolderStore(tmp_path / "store")
    path = tmp_path / "request.yaml"
    requests = make_requests(120)
    for request in requests:
        path.write_text(yaml.safe_dump(request))
        with pytest.raises(ConfigurationError) as refused:
            take_mask_request(store, path)
        said = str(refused.value)
        assert said.startswith(f"{path}:"), said
        assert refused.value.exit_code == 2
        assert len(said) < 12_000, "a person is to read it"
    assert len(requests) > 100
    assert not list((tmp_path / "store").rglob("artifact.json")), "nothing is kept"


def test_a_hundred_damaged_segmenters_are_each_told_by_file_or_are_still_whole(tmp_path):
    store, rng = FolderStore(tmp_path / "store"), random.Random(0)
    encoder, decoder = write_networks(tmp_path, "sam2")
    good, told = decoder.read_bytes(), list[str]()
    for _ in range(120):
        decoder.write_bytes(mutate(good, rng))
        try:
            recognise(encoder, decoder)  # damage that shows elsewhere is onnxruntime's to tell
        except ConfigurationError as refused:
            told.append(str(refused))
            with pytest.raises(ConfigurationError):
                take_segmenter(store, encoder, decoder)
    assert all(said.startswith(f"--segmenter {decoder}") and len(said) < 3000 for said in told)
    assert len(told) > 60
    assert not list((tmp_path / "store").rglob("artifact.json")), "nothing is kept"


@pytest.mark.parametrize("name", ["a point beside the box", "an unknown object removed"])
def test_a_run_with_a_mistaken_request_ends_before_any_stage(cli, capture: Path, tmp_path: Path, name: str) -> None:
    path = tmp_path / "request.yaml"
    path.write_text(yaml.safe_dump({"mask": BY_HAND[name]}))
    ended = cli("run", str(capture), "--mask", str(path), "--name", "tiny", "--stub")
    assert ended.returncode == 2
    assert f"{path}:" in ended.stderr
    assert not list(Path(cli.store).rglob("artifact.json"))
