"""python -m inpaint3d.stages.evaluation: see `inpaint3d.contracts.kit.shim`; `view`, `video` show fields."""

import sys

from inpaint3d.contracts.kit.shim import serve

if __name__ == "__main__":
    if sys.argv[1:2] in (["view"], ["video"]):
        from inpaint3d.stages.evaluation.viewer.command import look

        look(sys.argv[1:])
    serve("inpaint3d.stages.evaluation")
