"""Artifacts, schemas, store, keys and the stage shim."""
