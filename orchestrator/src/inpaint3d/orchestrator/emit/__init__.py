"""Manifests for engines that exist."""
