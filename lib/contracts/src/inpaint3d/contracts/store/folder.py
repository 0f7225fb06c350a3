"""The store in a local folder."""

import os
from pathlib import Path

from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.manifest import Manifest
from inpaint3d.contracts.store.artifact import find_folder_damage
from inpaint3d.contracts.store.base import Store
from inpaint3d.contracts.store.workspace import fsync, remove


class FolderStore(Store):
    """A store in a local folder, made where there is none."""

    def __init__(self, root: Path) -> None:
        super().__init__(root, str(root.resolve()))

    @property
    def is_writable(self) -> bool:
        return os.access(self.root, os.W_OK)

    def read(self, path: str) -> bytes | None:
        try:
            return (self.root / path).read_bytes()
        except FileNotFoundError:
            return None
        except IsADirectoryError:  # nothing that a store writes: whoever reads documents finds it unreadable
            return b""

    def write(self, path: str, data: bytes) -> None:
        target = self.root / path
        target.parent.mkdir(parents=True, exist_ok=True)
        self._stage(data).replace(target)

    def create(self, path: str, data: bytes) -> bool:
        target = self.root / path
        target.parent.mkdir(parents=True, exist_ok=True)
        staged = self._stage(data)
        try:
            target.hardlink_to(staged)
        except FileExistsError:
            return False
        finally:
            staged.unlink()
        fsync(target.parent)
        return True

    def _stage(self, data: bytes) -> Path:
        path = self.private_path()
        with path.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        return path

    def retire(self, path: str) -> None:
        if os.path.lexists(self.root / path):
            self.discard(self.root / path)

    def remove(self, path: str) -> None:
        remove(self.root / path)

    def names(self, folder: str) -> list[str]:
        path = self.root / folder
        return sorted(p.name for p in path.iterdir()) if path.is_dir() else []

    def fetch(self, digest: Digest) -> Path:
        if (damage := self.find_damage(digest)) is not None:
            self._refuse(digest, damage)
        return self.object_path(digest)

    def find_damage(self, digest: Digest) -> str | None:
        if not self.is_present(digest):
            return f"artifact {digest} is not in the store {self.place}"
        return find_folder_damage(self.object_path(digest), digest)

    def is_whole(self, digest: Digest) -> bool:
        return self.find_damage(digest) is None

    def is_present(self, digest: Digest) -> bool:
        return self.object_path(digest).is_dir()

    def size(self, digest: Digest) -> int:
        return sum(p.stat().st_size for p in self.object_path(digest).rglob("*") if p.is_file())

    def drop_object(self, digest: Digest) -> None:
        remove(self.object_path(digest))

    def quarantine(self, digest: Digest) -> None:
        if os.path.lexists(self.object_path(digest)):
            self.discard(self.object_path(digest))

    def _publish(self, folder: Path, manifest: Manifest) -> Digest:
        return self.keep(folder, manifest)
