"""A radiance field of the whole capture."""
