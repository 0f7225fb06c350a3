from pathlib import Path

import pytest

from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene


@pytest.fixture(scope="session")
def room() -> SyntheticScene:
    return synthetic_scene(views=6)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return FolderStore(tmp_path / "store")
