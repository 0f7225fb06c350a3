"""The cameras of a transforms.json as nerfstudio reads them, as JSON: cameras.py FOLDER, in the peer's environment."""

import json
import sys
from pathlib import Path

from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig


def main() -> None:
    config = NerfstudioDataParserConfig(
        data=Path(sys.argv[1]), orientation_method="none", center_method="none", auto_scale_poses=False, eval_mode="all"
    )
    read = config.setup().get_dataparser_outputs("train")
    cameras = read.cameras
    told = [
        {
            "name": path.name,
            "found": path.is_file(),
            "world_from_cam": cameras.camera_to_worlds[i].tolist(),
            "focal_centre": [float(part[i]) for part in (cameras.fx, cameras.fy, cameras.cx, cameras.cy)],
            "size": [int(cameras.width[i]), int(cameras.height[i])],
            "distortion": cameras.distortion_params[i].tolist(),
        }
        for i, path in enumerate(read.image_filenames)
    ]
    print(json.dumps(told))


if __name__ == "__main__":
    main()
