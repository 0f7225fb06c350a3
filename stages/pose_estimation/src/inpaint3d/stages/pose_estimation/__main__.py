"""python -m inpaint3d.stages.pose_estimation: see `inpaint3d.contracts.shim`."""

from inpaint3d.contracts.shim import serve

serve("inpaint3d.stages.pose_estimation")
