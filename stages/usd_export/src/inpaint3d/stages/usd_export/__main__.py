"""python -m inpaint3d.stages.usd_export: see `inpaint3d.contracts.kit.shim`."""

from inpaint3d.contracts.kit.shim import serve

serve("inpaint3d.stages.usd_export")
