"""Read artifacts, run, write artifacts."""

from inpaint3d.contracts.kit.shim import serve

if __name__ == "__main__":
    serve("inpaint3d.stages.view_completion")
