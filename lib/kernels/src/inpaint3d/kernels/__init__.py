"""Compiled CPU kernels (none yet)."""
