"""What looking after a fit's health costs, as a share of a training step: `python -m benchmarks.health`.

One thread, one run: CPU seconds of a step of nerf-pretraining at its defaults, of a look at the counters, and of the
check of every weight and moment before a checkpoint.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import torch

from inpaint3d.contracts.models.artifacts import EffectPlan
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.health import Health, check_finite
from inpaint3d.radiance.optim import Adam
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.joint_optimization.config import Config as JointConfig
from inpaint3d.stages.joint_optimization.loop import CHECKPOINT_INTERVAL_S
from inpaint3d.stages.nerf_pretraining.config import Config
from inpaint3d.stages.nerf_pretraining.fit import LOOKED_AT, Known, one_step

RESULTS = Path(__file__).parent / "results/health.json"


def cpu_s(what: Callable[[], object], times: int) -> float:
    begun = time.process_time()
    for _ in range(times):
        what()
    return (time.process_time() - begun) / times


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    torch.set_num_threads(1)
    config, scene = Config(), synthetic_scene(views=8)
    plan = EffectPlan(effects=())
    spec = field_spec(config.architecture, plan, views=8, centre_depth=0.85, points=scene.points.xyz)
    field = RadianceField(spec, 0)
    optimizer = Adam.of(field, config.optimizer, config.loss_weights)
    known = Known(Pixels.of(scene.cameras, list(scene.images), [None] * 8))
    generator, health = torch.Generator().manual_seed(0), Health()
    rays = known.pixels.draw(LOOKED_AT, generator)[0]
    optimizer.steps = config.ramp_steps  # all rays of a step
    step = cpu_s(lambda: one_step(field, known, optimizer, generator, config, {}), 15)
    look = cpu_s(lambda: health.look(field, rays), 10)
    check = cpu_s(lambda: check_finite(field, optimizer), 10)
    drawn = cpu_s(generator.get_state, 100)
    shares = {}
    for name, every, interval in (
        ("nerf-pretraining", config.score_every, config.checkpoint_every_s),
        ("joint-optimization", JointConfig().score_every, CHECKPOINT_INTERVAL_S),
    ):
        shares[name] = round((look / every + drawn) / step + check / interval, 5)
    result = {
        "step_ms": round(1e3 * step, 2), "look_ms": round(1e3 * look, 2), "check_ms": round(1e3 * check, 2),
        "share_of_a_step": shares,
    }  # fmt: skip
    RESULTS.write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
