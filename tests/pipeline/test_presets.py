"""The presets `paper` and `spin-nerf` hold the numbers of the paper (docs/conformance.md, rows N, L and S)."""

from collections.abc import Iterator

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import Pipeline, merge_parameters
from inpaint3d.orchestrator.configure import Settings, configure
from inpaint3d.orchestrator.parameter_schema import Place, parameter_schema
from inpaint3d.orchestrator.parameters import combine_parameters, parse_overrides
from tests.conftest import REPOSITORY

PIPELINE = Pipeline(REPOSITORY / "pipeline.yaml")

FIELD = {
    "levels": 10, "finest": 8192, "log2_table": 21, "channels": 4, "samples": 32, "proposal_samples": [64, 64],
    "proposal_levels": 10, "proposal_finest": 8192, "proposal_log2_table": 21,
}  # fmt: skip
BOTH = {
    "start": "fresh",
    "rays": 2**16, "architecture": FIELD,  # N2, N3, N8
    "optimizer": {
        "learning_rate": 1e-2, "final_learning_rate": 1e-3, "learning_rate_steps": 2200, "learning_rate_warmup": 100,
    },  # N7
    "loss_weights": {
        "reconstruction": 1.0, "interlevel": 1.0, "distortion": 0.005,  # L3
        "hash_decay": 0.1,  # N9
        "line_of_sight": 0.0,  # the paper knows no sparse points
    },
    "estimator": {
        "name": "sds", "hole": "as-masked", "distill_every": 1, "diffuse_start": True,
        "weight_warmup": 100,  # S6
        "t_min": 0.2, "t_max": 0.95, "t_width": 0.2, "t_floor": 0.02, "schedule_steps": 2200,  # S9
        "span_first": 0.711, "span_last": 0.711,  # S1
    },
}  # fmt: skip
OWN = {
    "paper": {
        "steps": 1600, "loss_weights": {"depth": 1e-4},  # S11, L3
        "depth_patches": 4, "depth_patch_size": 64,  # L6
        "estimator": {
            "guidance": 8.0, "weight": 0.1, "weight_decay_to": 1.0, "warmup_steps": 200, "centre_steps": 50,
        },  # S5 to S8
    },
    "spin-nerf": {
        "steps": 1200, "loss_weights": {"depth": 0.0},
        "estimator": {
            "guidance": 5.0, "weight": 2.0, "weight_decay_to": 0.25, "warmup_steps": 400, "centre_steps": 0,
        },
    },  # S13
}  # fmt: skip


@pytest.mark.parametrize("preset", OWN)
def test_the_joint_optimisation_has_the_paper_s_numbers(preset):
    chosen = combine_parameters(PIPELINE, "joint-optimization", preset, {})
    for wanted in (BOTH, OWN[preset]):
        assert merge_parameters(chosen, wanted) == chosen


@pytest.mark.parametrize("preset", OWN)
@pytest.mark.parametrize(
    "node", ["nerf-pretraining", "masked-reconstruction", "continued-reconstruction", "joint-optimization"]
)
def test_the_paper_s_fields_learn_nothing_from_sparse_points(node, preset):
    assert combine_parameters(PIPELINE, node, preset, {})["loss_weights"]["line_of_sight"] == 0.0


def test_a_patch_of_the_paper_is_its_prior_s_pixels():
    """S1: at 360 x 640 the asked share of the short side is 256 pixels, one for each of the prior's."""
    share = PIPELINE.parameters("joint-optimization", "paper")["estimator"]["span_first"]
    assert round(share * 360) == PIPELINE.parameters("diffusion-training", "paper")["prior"]["size"] == 256


def test_what_is_compared_with_the_result_takes_as_many_steps():
    for preset in PIPELINE.spec.spec.presets:
        joint, continued = (
            combine_parameters(PIPELINE, node, preset, {})
            for node in ("joint-optimization", "continued-reconstruction")
        )
        assert (joint["steps"], joint["rays"], joint["loss_weights"]) == (
            continued["steps"],
            continued["rays"],
            continued["loss_weights"],
        ), preset


@pytest.mark.parametrize(
    ("assignment", "port"),
    [
        ("joint-optimization.architecture.view_width=32", "initial-field"),
        ("joint-optimization.optimizer.proposal_anneal_steps=5", "initial-field"),
        ("masked-reconstruction.optimizer.warm_start_lr_scale=0.5", "initial-field"),
    ],
)
def test_what_a_field_s_start_leaves_without_effect_is_refused(assignment, port):
    asked = Settings("standard", parse_overrides(PIPELINE, [assignment]))
    with pytest.raises(ConfigurationError, match=f"{assignment.partition('=')[0]} changes nothing where .*{port}"):
        configure(PIPELINE, asked, {"capture"})


def test_a_parameter_of_the_sampler_that_a_field_does_not_have_is_refused():
    node = "masked-reconstruction.architecture"
    grid = [f"{node}.sampler=density-grid", f"{node}.density_bins=32"]
    asked = Settings("standard", parse_overrides(PIPELINE, grid))
    assert (
        configure(PIPELINE, asked, {"capture"}).parameters["masked-reconstruction"]["architecture"]["density_bins"]
        == 32
    )
    for assignment, sampler in ((grid[1:], "density-grid"), ([grid[0], f"{node}.proposal_levels=4"], "proposal")):
        asked = Settings("standard", parse_overrides(PIPELINE, assignment))
        name = assignment[-1].partition("=")[0]
        with pytest.raises(
            ConfigurationError, match=f"{name} changes nothing: it counts under {node}.sampler={sampler}"
        ):
            configure(PIPELINE, asked, {"capture"})


SDS, SAMPLES = "estimator=sds", "method=prior-samples"


@pytest.mark.parametrize(
    ("node", "assignment", "idle", "acting"),
    [
        ("masked-reconstruction", "optimizer.proposal_anneal_steps=5", ["architecture.sampler=density-grid"], []),
        ("nerf-pretraining", "loss_weights.interlevel=0.5", ["architecture.sampler=density-grid"], []),
        ("nerf-pretraining", "line_of_sight_rays=8", ["loss_weights.line_of_sight=0"], []),
        ("nerf-pretraining", "first_rays=64", ["ramp_steps=0"], []),
        ("joint-optimization", "line_of_sight_rays=8", ["loss_weights.line_of_sight=0"], []),
        ("joint-optimization", "depth_patches=2", ["loss_weights.depth=0"], []),
        ("joint-optimization", "depth_patch_size=16", ["loss_weights.depth=0"], []),
        ("joint-optimization", "estimator.span=0.5", ["estimator.weight=0"], []),
        ("joint-optimization", "estimator.min_known=0.5", ["estimator.weight=0"], []),
        ("joint-optimization", "estimator.centre_views=2", ["estimator.centre_steps=0"], []),
        ("joint-optimization", "estimator.min_supporting_views=3", [SDS, "estimator.hole=as-masked"], [SDS]),
        ("view-completion", "method.min_supporting_views=3", [SAMPLES, "method.hole=as-masked"], [SAMPLES]),
        ("mask-authoring", "margin=0.3", ["refine=false"], []),
        ("mask-authoring", "refine_rounds=2", ["refine=false"], []),
        ("pose-estimation", "lens=RADIAL", ["cameras=known"], []),
        ("pose-estimation", "min_registered=5", ["cameras=known"], []),
        ("pose-estimation", "min_view_agreement=0.2", ["cameras=estimate"], []),
        ("pose-estimation", "exhaustive_up_to=9", ["matching=sequential"], []),
        ("pose-estimation", "overlap=9", ["matching=exhaustive"], ["matching=sequential"]),
        ("pose-estimation", "keep_test_from=9", ["test_every=0"], []),
        ("evaluation", "full_views=1", ["truth_views=0"], []),
        ("capture-ingest", "video_frames=9", ["layout=photos"], ["layout=video"]),
        ("capture-ingest", "spin_nerf_truth=9", ["layout=llff"], []),
    ],
)
def test_what_another_parameter_leaves_without_effect_is_refused(node, assignment, idle, acting):
    """idle, acting: settings beside which the parameter does nothing, and beside which it does something."""

    def configure_with(others):
        asked = parse_overrides(PIPELINE, [f"{node}.{words}" for words in (*others, assignment)])
        return configure(PIPELINE, Settings("standard", asked), {"capture", "mask-request", "pretrained-prior"})

    configure_with(acting)
    with pytest.raises(ConfigurationError, match=f"{node}.{assignment.partition('=')[0]} changes nothing"):
        configure_with(idle)


def test_a_fresh_start_is_refused_where_there_is_nothing_else_to_start_from():
    asked = Settings("standard", parse_overrides(PIPELINE, ["masked-reconstruction.start=fresh"]))
    with pytest.raises(ConfigurationError, match=r"start changes nothing where no initial-field is wired"):
        configure(PIPELINE, asked, {"capture"})


@pytest.mark.parametrize(
    ("assignments", "external"),
    [
        ([f"joint-optimization.{SDS}", "joint-optimization.estimator.prompt=a lawn"], "diffusers-pipeline"),
        ([f"view-completion.{SAMPLES}", "view-completion.method.prompt=a lawn"], "diffusers-pipeline"),
        (["diffusion-training.steps=9", "diffusion-training.corpus_share=0.2"], "image-corpus"),
        (["diffusion-training.steps=9", "diffusion-training.fine_tuning_rate=0.0001"], "pretrained-prior"),
    ],
)
def test_what_counts_for_an_external_alone_is_refused_without_it(assignments, external):
    asked = Settings("standard", parse_overrides(PIPELINE, assignments), named=("diffusion-training",))
    configure(PIPELINE, asked, {"capture", "pretrained-prior", external})
    with pytest.raises(ConfigurationError, match=f"changes nothing where no {external} is read"):
        configure(PIPELINE, asked, {"capture", "pretrained-prior"} - {external})


def test_what_an_external_does_instead_is_refused_beside_it():
    asked = Settings("standard", parse_overrides(PIPELINE, ["mask-authoring.grabcut_rounds=2"]))
    configure(PIPELINE, asked, {"capture", "mask-request"})
    with pytest.raises(ConfigurationError, match=r"mask-authoring\.grabcut_rounds changes nothing where segmenter"):
        configure(PIPELINE, asked, {"capture", "mask-request", "segmenter"})


def test_schemas_name_parameters_and_ports_that_there_are():
    """A misspelt condition would never refuse anything, or fail where it is first looked up."""
    for node in PIPELINE.order:
        root = parameter_schema(PIPELINE, node)
        ports = set(PIPELINE.stages[node].spec.inputs)
        for place, group in _list_places(root):
            said = place.written
            assert {said[word] for word in ("x-with", "x-without") if word in said} <= ports, node
            for path in [*said.get("x-under", {}), *said.get("x-unless", {})]:
                here = group if path.split(".")[0] in group.properties else root
                for name in path.split("."):
                    here = here.properties[name]


def _list_places(group: Place) -> Iterator[tuple[Place, Place]]:
    """Every parameter below a group, with the group that it is of."""
    for kind in [*group.kinds.values()] or [group]:
        for place in kind.properties.values():
            yield place, kind
            yield from _list_places(place)


@pytest.mark.parametrize("preset", PIPELINE.spec.spec.presets)
def test_every_parameter_of_a_preset_acts(preset):
    configured = configure(
        PIPELINE, Settings(preset, compare=True, named=("diffusion-training",)), {"capture", "pretrained-prior"}
    )
    assert "joint-optimization" in configured.pipeline.nodes
