"""What effects cost on this machine: steps of a field of standard size with each of them, against the plain field."""

import resource
import time
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Effect, EffectPlan, FieldSpec
from inpaint3d.radiance.architecture import Architecture
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.fitting import LossWeights, Optimizer
from inpaint3d.radiance.optim import Adam
from inpaint3d.radiance.rays import Rays
from inpaint3d.radiance.rendering import render
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.training import descend, reconstruction, regularisers

IN_FIELD = ("exposure", "view-dependence", "contraction")
"""Effects that are part of the field, and so of every step. The others cost nothing there."""
RAYS = 512
NUMBERS_A_PARAMETER = 4  # itself, its gradient, Adam's two moments
PLAIN = "none"

Row = dict[str, float | str]


def measure_costs(points: NDArray[np.float32], views: int, steps: int, threads: int, seed: int) -> Iterator[Row]:
    """A row for each effect: CPU ms of a step and the ratio to the plain field's, bytes of what is learnt for it.

    The first steps, which start threads and allocate, are not counted. Nothing for 0 steps. The fields take turns, so
    that what else the machine does falls on all alike.
    """
    if not steps:
        return
    torch.set_num_threads(threads)
    probes = {name: Probe(plan_of(name), points, views, seed) for name in (PLAIN, *IN_FIELD)}
    times: dict[str, list[float]] = {name: [] for name in probes}
    for step in range(steps + 2):
        for name, probe in probes.items():
            begun = time.process_time()
            probe.take_step()
            if step > 1:
                times[name].append(time.process_time() - begun)
    plain = float(np.median(times[PLAIN]))
    for name, probe in probes.items():
        middle = float(np.median(times[name]))
        yield {
            "effect": name,
            "step_cpu_ms": round(1e3 * middle, 3),
            "ratio": round(middle / plain, 4),
            "bytes": float(probe.bytes - probes[PLAIN].bytes),
            "peak_memory_bytes": float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024),
        }


def plan_of(name: str) -> EffectPlan:
    """A plan with one effect on."""
    return EffectPlan(effects=(Effect(name=name, state="on", evidence={}, reason="its cost is measured"),))


class Probe:
    """A field of standard size with the effects of a plan, to take steps of."""

    def __init__(self, plan: EffectPlan, points: NDArray[np.float32], views: int, seed: int) -> None:
        spec: FieldSpec = field_spec(Architecture(), plan, views=views, centre_depth=1.0, points=points)
        self._field = RadianceField(spec, seed)
        self._weights, self._non_finite = LossWeights(), dict[str, int]()
        self._optimizer = Adam.of(self._field, Optimizer(), self._weights)
        self._generator = torch.Generator().manual_seed(seed)
        self._views = views

    @property
    def bytes(self) -> int:
        """Of the field's parameters, their gradients and the optimiser's moments."""
        return NUMBERS_A_PARAMETER * sum(p.numel() * p.element_size() for p in self._field.parameters())

    def take_step(self) -> None:
        """Random rays from within the unit ball, to random colours."""
        draw = torch.randn(RAYS, 6, generator=self._generator)
        direction = torch.nn.functional.normalize(draw[:, 3:], dim=-1)
        rays = Rays(0.5 * draw[:, :3].tanh(), direction, torch.arange(RAYS) % self._views)
        seen = render(self._field, rays, generator=self._generator)
        target = torch.rand(RAYS, 3, generator=self._generator)
        terms = {"reconstruction": reconstruction(seen.rgb, target), **regularisers(seen, self._weights)}
        descend(self._field, self._optimizer, terms, 1e-3, self._non_finite)
