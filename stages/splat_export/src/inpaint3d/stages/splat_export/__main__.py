"""Read a radiance-field, write a splat-scene."""

from inpaint3d.contracts.kit.shim import serve

if __name__ == "__main__":
    serve("inpaint3d.stages.splat_export")
