"""Read artifacts -> run() -> write artifacts; the shim does the rest."""

from inpaint3d.contracts.shim import serve

if __name__ == "__main__":
    serve("inpaint3d.stages.pose_estimation")
