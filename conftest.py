"""Shapes and types of what the two numeric libraries are called with are checked at run time, in every test."""

from jaxtyping import install_import_hook

# Before any test module imports them, so that a test alone sees what it sees in the whole suite.
install_import_hook(["inpaint3d.diffusion", "inpaint3d.radiance"], "beartype.beartype")
