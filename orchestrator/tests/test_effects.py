"""Effects are switched by name, and what cannot be is refused before anything runs."""

from pathlib import Path

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.configure import Settings, configure
from inpaint3d.orchestrator.effects import find_analysis, find_deciders, switch_effects
from inpaint3d.orchestrator.parameters import parse_overrides
from inpaint3d.scene.effects import DECIDED_IN, load

PIPELINE = Pipeline(Path(__file__).parents[2] / "pipeline.yaml")


def switch(*lines, sets=()):
    return switch_effects(PIPELINE, lines, parse_overrides(PIPELINE, list(sets)))


def configured(*lines, sets=()):
    return configure(PIPELINE, Settings("standard", switch(*lines, sets=sets)), {"capture"}).parameters


def test_every_effect_that_is_measured_can_be_named():
    measured = {name for name in DECIDED_IN if hasattr(load(name), "measure")}
    assert set(find_deciders(PIPELINE)) == measured
    assert find_analysis(PIPELINE) == "scene-analysis"


def test_effects_reach_the_stage_that_decides_them():
    found = configured("exposure=off", "lens-distortion=off", "blur=on")
    assert found["scene-analysis"]["force"] == {"exposure": False, "blur": True}
    assert found["pose-estimation"]["force"] == {"lens-distortion": False}


def test_auto_changes_no_key():
    assert configured("exposure=auto") == configured()


def test_an_effect_and_set_go_together():
    found = switch("exposure=off", sets=["scene-analysis.force.blur=true"])
    assert found["scene-analysis"]["force"] == {"exposure": False, "blur": True}


@pytest.mark.parametrize(
    ("lines", "sets", "said"),
    [
        (["fog=on"], [], "no effect fog can be switched; there are lens-distortion, exposure"),
        (["expsure=on"], [], "did you mean exposure"),
        (["depth-smoothness=off"], [], "no effect depth-smoothness can be switched"),
        (["exposure=maybe"], [], "write exposure=on, exposure=off or exposure=auto"),
        (["exposure"], [], "write exposure=on"),
        (["exposure=on", "exposure=off"], [], "contradicts another --effect exposure"),
        (["exposure=auto", "exposure=off"], [], "contradicts another --effect exposure"),
        (["exposure=on"], ["scene-analysis.force.exposure=false"], "contradicts --set scene-analysis.force"),
        (["vignetting=on"], [], "no code simulates it"),
        (["lens-distortion=off"], ["pose-estimation.lens=OPENCV"], "lens=OPENCV decides it too"),
    ],
)
def test_what_cannot_be_is_said_before_anything_runs(lines, sets, said):
    with pytest.raises(ConfigurationError, match=said):
        configured(*lines, sets=sets)
