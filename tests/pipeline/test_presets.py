"""The presets `paper` and `spin-nerf` hold the numbers of the paper (docs/conformance.md, rows N, L and S)."""

import pytest

from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.parameters import combine_parameters
from tests.conftest import REPOSITORY

PIPELINE = Pipeline(REPOSITORY / "pipeline.yaml")

FIELD = {
    "levels": 10, "finest": 8192, "log2_table": 21, "channels": 4, "samples": 32, "proposal_samples": [64, 64],
    "proposal_levels": 10, "proposal_finest": 8192, "proposal_log2_table": 21,
}  # fmt: skip
BOTH = {
    "estimator": "sds", "start": "fresh", "hole": "as-masked", "distill_every": 1, "diffuse_start": True,
    "rays": 2**16, "architecture": FIELD,  # N2, N3, N8
    "learning_rate": 1e-2, "final_learning_rate": 1e-3, "learning_rate_steps": 2200, "learning_rate_warmup": 100,  # N7
    "hash_decay_weight": 0.1,  # N9
    "reconstruction_weight": 1.0, "interlevel_weight": 1.0, "distortion_weight": 0.005,  # L3
    "depth_patches": 4, "depth_patch_size": 64,  # L6
    "sight_weight": 0.0,  # the paper knows no sparse points
    "weight_warmup": 100,  # S6
    "t_min": 0.2, "t_max": 0.95, "t_width": 0.2, "t_floor": 0.02, "schedule_steps": 2200,  # S9
    "span_first": 0.711, "span_last": 0.711,  # S1
}  # fmt: skip
OWN = {
    "paper": {
        "guidance": 8.0, "weight": 0.1, "weight_decay_to": 1.0, "warmup_steps": 200, "centre_steps": 50,
        "steps": 1600, "depth_weight": 1e-4,
    },  # S5 to S8, S11, L3
    "spin-nerf": {
        "guidance": 5.0, "weight": 2.0, "weight_decay_to": 0.25, "warmup_steps": 400, "centre_steps": 0,
        "steps": 1200, "depth_weight": 0.0,
    },  # S13
}  # fmt: skip


@pytest.mark.parametrize("preset", OWN)
def test_the_joint_optimisation_has_the_paper_s_numbers(preset):
    chosen = combine_parameters(PIPELINE, "joint-optimization", preset, {})
    field = chosen["architecture"]
    chosen["architecture"] = {name: field[name] for name in FIELD}  # the others are the project's own
    wanted = BOTH | OWN[preset]
    assert {name: chosen[name] for name in wanted} == wanted


@pytest.mark.parametrize("preset", OWN)
@pytest.mark.parametrize(
    "node", ["nerf-pretraining", "masked-reconstruction", "continued-reconstruction", "joint-optimization"]
)
def test_the_paper_s_fields_learn_nothing_from_sparse_points(node, preset):
    assert combine_parameters(PIPELINE, node, preset, {})["sight_weight"] == 0.0


def test_a_patch_of_the_paper_is_its_prior_s_pixels():
    """S1: at 360 x 640 the asked share of the short side is 256 pixels, one for each of the prior's."""
    share = PIPELINE.parameters("joint-optimization", "paper")["span_first"]
    assert round(share * 360) == PIPELINE.parameters("diffusion-training", "paper")["prior"]["size"] == 256


def test_what_is_compared_with_the_result_takes_as_many_steps():
    for preset in PIPELINE.spec.spec.presets:
        joint, continued = (
            combine_parameters(PIPELINE, node, preset, {})
            for node in ("joint-optimization", "continued-reconstruction")
        )
        assert (joint["steps"], joint["rays"], joint["depth_weight"]) == (
            continued["steps"],
            continued["rays"],
            continued["depth_weight"],
        ), preset
