"""The kernels against one core: `python -m benchmarks.radiance.kernels` prints one JSON object.

Networks: multiply-adds over the time taken, over the measured peak. `mlp_fma_share` counts those performed (for each
weight and row: one forward, two backward, and one more for hidden layers, which the backward pass computes again),
`mlp_useful_share` those that the mathematics asks for. What pads a width to whole vectors counts as nothing.

Encoding: the time in which the core merely reads, one random cache line after another, the distinct lines that the
corners of every point lie in, each level's from memory of that level's size; over the time taken.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch

from inpaint3d import kernels
from inpaint3d.radiance.architecture import Level, levels_of
from inpaint3d.radiance.backends import reference

NETWORKS = ((32, 64, 19), (15, 64, 64, 3), (64, 64, 64, 64))
TABLES = (17, 19)
LEVELS, COARSEST, FINEST, CHANNELS = 8, 16, 1024, 4
LINE = 64


class Core:
    """What one core reaches, by the program in machine.cpp, compiled here for this processor."""

    def __init__(self, folder: Path) -> None:
        self._program = folder / "machine"
        source = Path(__file__).with_name("machine.cpp")
        compiler = os.environ.get("CXX", "c++")
        flags = ["-O3", "-march=native", "-std=c++17"]
        subprocess.run([compiler, *flags, "-o", str(self._program), str(source)], check=True)

    def fma_gflops(self) -> float:
        return self._run("fma")[0]

    def read_ns(self, sizes: list[int]) -> list[float]:
        """Nanoseconds of one read of a random line, for memory of each size in bytes."""
        return self._run("gather", *map(str, sizes))

    def _run(self, *words: str) -> list[float]:
        done = subprocess.run([str(self._program), *words], check=True, capture_output=True, text=True)
        return [float(word) for word in done.stdout.split()]


def best_s(work: Callable[[], object], repeats: int) -> float:
    """Least CPU seconds of a call; the first is not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def network_times(widths: tuple[int, ...], rows: int, repeats: int) -> dict[str, float]:
    """GFLOP and seconds of a network of these widths, forward and backward."""
    rng = np.random.default_rng(0)

    def numbers(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, np.float32)

    pairs = list(pairwise(widths))
    x, weights = numbers(rows, widths[0]), [numbers(out, into) / into**0.5 for into, out in pairs]
    out, out_grad = np.empty((rows, widths[-1]), np.float32), numbers(rows, widths[-1])
    network = kernels.Network(x, weights, None)
    grads = kernels.Network(np.empty_like(x), [np.empty_like(weight) for weight in weights], None)
    layers = [2e-9 * rows * into * wide for into, wide in pairs]
    work = sum(layers)
    return {
        "again_gflop": sum(layers[:-1]),
        "forward_gflop": work,
        "forward_s": best_s(lambda: kernels.mlp_forward(network, out), repeats),
        "backward_gflop": 2 * work,
        "backward_s": best_s(lambda: kernels.mlp_backward(network, out_grad, grads), repeats),
    }


def lines_of(points: torch.Tensor, level: Level) -> int:
    """Distinct cache lines, point by point, that the corners lie in."""
    entry, _ = reference.corners(points.T.contiguous(), level)
    line = ((entry + level.offset) * (4 * CHANNELS) // LINE).numpy()
    line.sort(axis=0)
    return int(line.shape[1] + (np.diff(line, axis=0) != 0).sum())


def encoding(core: Core, log2_table: int, count: int, repeats: int) -> dict[str, Any]:
    """Share of the reading rate that the encoding of random points reaches, and what it is made of."""
    levels = levels_of(LEVELS, COARSEST, FINEST, log2_table)
    generator = torch.Generator().manual_seed(0)
    table = torch.rand(levels[-1].offset + levels[-1].size, CHANNELS, generator=generator)
    points = torch.rand(count, 3, generator=generator)
    out = np.empty((count, LEVELS * CHANNELS), np.float32)
    taken = best_s(lambda: kernels.hash_forward(points.numpy(), table.numpy(), levels, out), repeats)
    lines = [lines_of(points, level) for level in levels]
    read_ns = core.read_ns([level.size * 4 * CHANNELS for level in levels])
    return {
        "ns_per_point": taken / count * 1e9,
        "corners_per_s": 8 * LEVELS * count / taken,
        "lines_per_point": sum(lines) / count,
        "read_ns_by_level": read_ns,
        "gather_share": sum(n * ns for n, ns in zip(lines, read_ns, strict=True)) * 1e-9 / taken,
    }


def measure(rows: int, points: int, repeats: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        core = Core(Path(folder))
        peaks = [core.fma_gflops()]
        times = {str(list(widths)): network_times(widths, rows, repeats) for widths in NETWORKS}
        # The clock of a core may drift: the peak is measured before and after, and the larger counts.
        peaks.append(core.fma_gflops())
        encodings = {f"2^{log2}": encoding(core, log2, points, repeats) for log2 in TABLES}
    peak = max(peaks)
    networks = {
        name: {way: t[f"{way}_gflop"] / t[f"{way}_s"] / peak for way in ("forward", "backward")}
        for name, t in times.items()
    }
    useful = sum(t["forward_gflop"] + t["backward_gflop"] for t in times.values())
    again = sum(t["again_gflop"] for t in times.values())
    taken = sum(t["forward_s"] + t["backward_s"] for t in times.values())
    return {
        "isa": kernels.isa(),
        "rows": rows,
        "points": points,
        "fma_gflops": peak,
        "mlp_fma_share": (useful + again) / taken / peak,
        "mlp_useful_share": useful / taken / peak,
        "mlp_useful_share_by_network": networks,
        "encode_gather_share": encodings[f"2^{TABLES[0]}"]["gather_share"],
        "encodings": encodings,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=16384)
    parser.add_argument("--points", type=int, default=2**18)
    parser.add_argument("--repeats", type=int, default=20)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(json.dumps(measure(options.rows, options.points, options.repeats)))


if __name__ == "__main__":
    main()
