"""Cameras, colour, image files, geometry and reprojection in numpy."""
