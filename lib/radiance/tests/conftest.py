"""Shapes and types of every function in the library are checked while its tests run."""

from jaxtyping import install_import_hook

# Before any test module imports the library.
install_import_hook("inpaint3d.radiance", "beartype.beartype")
