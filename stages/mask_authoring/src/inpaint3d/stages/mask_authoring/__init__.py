"""A mask in 3D from a request, carried to every view."""
