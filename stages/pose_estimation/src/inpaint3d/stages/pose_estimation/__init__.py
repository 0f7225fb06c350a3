"""Cameras and sparse points from pictures."""
