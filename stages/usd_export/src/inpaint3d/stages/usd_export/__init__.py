"""The inpainted scene as USD."""
