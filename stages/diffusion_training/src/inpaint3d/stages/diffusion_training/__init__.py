"""A 2D inpainting diffusion prior."""
