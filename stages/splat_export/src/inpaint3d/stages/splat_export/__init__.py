"""The inpainted scene as 3D Gaussian splats, for splat viewers and USD."""
