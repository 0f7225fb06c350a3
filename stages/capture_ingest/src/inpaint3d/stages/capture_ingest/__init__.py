"""Photos, a video or a dataset become a capture."""
