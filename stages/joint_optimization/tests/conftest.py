"""The synthetic room as a posed capture with masks, a plan and an untrained prior, in a store."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inpaint3d.contracts.models.artifacts import PriorSpec
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from tests.room_artifacts import PRIOR, put_masks, put_plan, put_posed, put_prior


@pytest.fixture(scope="session")
def room() -> SyntheticScene:
    return synthetic_scene(views=6)


@pytest.fixture(scope="session")
def prior_spec() -> PriorSpec:
    return PRIOR


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return FolderStore(tmp_path / "store")


@pytest.fixture
def inputs(store: Store, room: SyntheticScene) -> Callable[..., dict[str, Any]]:
    """Input digests; `images` replaces the room's pictures, `plan` names the effects on, `masked` views have a mask."""

    def make(
        images: np.ndarray | None = None, plan: tuple[str, ...] = ("view-dependence",), masked: int | None = None
    ) -> dict[str, Any]:
        return {
            "posed-capture": put_posed(store, room, room.images if images is None else images),
            "effect-plan": put_plan(store, *plan),
            "mask-set": put_masks(store, room.names[:masked], room.object_masks[:masked]),
            "diffusion-prior": put_prior(store),
        }

    return make
