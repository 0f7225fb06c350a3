"""Which store a place names."""

from pathlib import Path

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.store.base import Store
from inpaint3d.contracts.store.folder import FolderStore


def open_store(place: str) -> Store:
    """The store at a place: `s3://BUCKET/PREFIX`, or a local folder. ConfigurationError where it is neither."""
    if place.startswith("s3://"):
        from inpaint3d.contracts.store.bucket import BucketStore  # its client library is loaded where it is needed

        return BucketStore(place)
    if "://" in place:
        raise ConfigurationError(f"--store {place}: a store is a folder or s3://BUCKET/PREFIX")
    return FolderStore(Path(place))
