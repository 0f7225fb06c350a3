"""Stores: what every one does (`base`), in a local folder (`folder`), in a bucket (`bucket`, imported where needed)."""

from inpaint3d.contracts.store.artifact import (
    Artifact,
    Record,
    hex_of,
    key_of,
    key_path,
    load_artifact,
    load_manifest,
    object_file,
)
from inpaint3d.contracts.store.base import Store
from inpaint3d.contracts.store.folder import FolderStore
from inpaint3d.contracts.store.owner import Owner, parse_owner, this_process
from inpaint3d.contracts.store.place import open_store
from inpaint3d.contracts.store.workspace import note

__all__ = [
    "Artifact",
    "FolderStore",
    "Owner",
    "Record",
    "Store",
    "hex_of",
    "key_of",
    "key_path",
    "load_artifact",
    "load_manifest",
    "note",
    "object_file",
    "open_store",
    "parse_owner",
    "this_process",
]
