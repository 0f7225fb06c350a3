"""Renders views of a usdz in Blender, by a Python that has `bpy`: blender.py SCENE.usdz OUT VIEW [VIEW ...]

Stands alone: it runs in an environment of its own, in which this project is not installed.
"""

import argparse
from pathlib import Path

WIDTH = 480


def main(scene: str, out: str, views: list[str]) -> None:
    """Write OUT/VIEW.png of each camera `View_NNNN`, and print its lens in millimetres."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=scene, import_guide=True, support_scene_instancing=False)
    render = bpy.context.scene.render
    render.engine = "CYCLES"
    bpy.context.scene.cycles.samples = 16
    bpy.context.scene.cycles.use_denoising = False
    # The photos' light is in the textures: shown as they are, without a film's tone curve.
    bpy.context.scene.view_settings.view_transform = "Standard"
    for thing in bpy.data.objects:
        thing.hide_render = thing.name.startswith(("Hull", "Volume_", "SparsePoints", "Piece_"))
    for view in views:
        camera = next(
            c for c in bpy.data.objects if c.type == "CAMERA" and view in (c.name, c.parent and c.parent.name)
        )
        lens = camera.data
        aspect = lens.sensor_height / lens.sensor_width
        render.resolution_x, render.resolution_y = WIDTH, round(WIDTH * aspect)
        bpy.context.scene.camera = camera
        render.filepath = str(Path(out) / f"{view}.png")
        bpy.ops.render.render(write_still=True)
        print(f"{view}: {lens.lens:.2f} mm on {lens.sensor_width:.2f} x {lens.sensor_height:.2f} mm")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene")
    parser.add_argument("out")
    parser.add_argument("views", nargs="+")
    given = parser.parse_args()
    main(given.scene, given.out, given.views)
