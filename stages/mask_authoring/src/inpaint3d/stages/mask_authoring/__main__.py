"""Read artifacts, author masks, write them; `edit` serves a page on which a person says what is to be masked."""

import sys

from inpaint3d.contracts.kit.shim import serve

if __name__ == "__main__":
    if sys.argv[1:2] == ["edit"]:
        from inpaint3d.stages.mask_authoring.page.command import edit

        edit(sys.argv[2:])
    serve("inpaint3d.stages.mask_authoring")
