"""Read a posed capture, decide its effects, write the plan."""

from inpaint3d.contracts.kit.shim import serve

if __name__ == "__main__":
    serve("inpaint3d.stages.scene_analysis")
