"""Write clean plates."""

from inpaint3d.contracts.kit.shim import serve

if __name__ == "__main__":
    serve("inpaint3d.stages.plate_export")
