"""Plates of the synthetic room, as small as its photos, through the same writers."""

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.stages.plate_export.config import Config


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Made as ever, without registration and grain: the room's depths are true, and it has no noise."""
    from inpaint3d.stages.plate_export.run import run  # COLMAP's model is written by its own library

    run(config.model_copy(update={"registration": False, "grain": False}), inputs, outputs, ctx)
