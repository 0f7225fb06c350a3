"""From what a command line asks to what runs: every parameter and seed known, nodes that nobody asks for left out."""

import functools
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.cluster import Submission
from inpaint3d.contracts.models.pipeline import Parameters, Pipeline
from inpaint3d.contracts.models.report import NodeRun
from inpaint3d.orchestrator.parameter_schema import parameter_schema
from inpaint3d.orchestrator.parameters import SEED, Overrides, combine_parameters
from inpaint3d.orchestrator.prune import PrunedPipeline, prune
from inpaint3d.orchestrator.unused import find_unused


@dataclass(frozen=True)
class Settings:
    """What is asked of a pipeline, alike for every scene."""

    preset: str | None = None
    overrides: Overrides = field(default_factory=Overrides)
    compare: bool = False
    """Whether the controls are wanted too."""
    seed: int = 0
    named: tuple[str, ...] = ()
    """Nodes that a selection or `--want` names: wanted too."""


@dataclass(frozen=True)
class ConfiguredPipeline:
    """A pipeline that is ready to be planned."""

    pipeline: Pipeline
    """With the nodes that run."""
    preset: str | None
    parameters: dict[str, Parameters]
    seeds: dict[str, int]
    left_out: dict[str, str]
    """Node -> why it does not run."""

    @functools.cached_property
    def left_out_rows(self) -> tuple[NodeRun, ...]:
        """As a run's record has them."""
        return tuple(NodeRun(node=node, status="left-out", reason=why) for node, why in self.left_out.items())


def configure(
    pipeline: Pipeline, settings: Settings, given: Collection[str], options: Mapping[str, str] | None = None
) -> ConfiguredPipeline:
    """Resolve the parameters of every node, whether it runs or not, and keep what is wanted.

    given: the externals that there are. options: of these, what the command line gave, as it gave it (`--mask FILE`).
    Raises ConfigurationError for a wrong parameter, and for a parameter or an option that would change nothing.
    """
    chosen = pipeline.under(settings.preset)
    overrides = settings.overrides
    parameters = {node: combine_parameters(chosen, node, settings.preset, overrides) for node in chosen.order}
    pruned = prune(chosen, parameters, _list_wanted(chosen, settings), given)
    _refuse_overrides(pruned, overrides)
    _refuse_unused(pruned, parameters, given)
    _refuse_options(pruned, options or {})
    return ConfiguredPipeline(
        pipeline=pruned.pipeline,
        preset=settings.preset,
        parameters={node: parameters[node] for node in pruned.pipeline.order},
        seeds={n: choose_seed(chosen, n, settings) for n in pruned.pipeline.order},
        left_out=pruned.left_out,
    )


def configure_submission(pipeline: Pipeline, submission: Submission) -> ConfiguredPipeline:
    """The pipeline of a submission, whose scenes all have the same externals but for what comes later."""
    given = {external for scene in submission.scenes for external in scene.externals}
    given |= set(submission.awaited)
    settings = Settings(
        submission.preset, submission.overrides, submission.compare, submission.seed, named=submission.want
    )
    return configure(pipeline, settings, given)


def _list_wanted(pipeline: Pipeline, settings: Settings) -> list[str]:
    body = pipeline.spec.spec
    wants = [*(body.wants or [n for n in pipeline.order if n not in body.compare]), *settings.named]
    return [node for node in [*wants, *(body.compare if settings.compare else [])] if node in pipeline.nodes]


def choose_seed(pipeline: Pipeline, node: str, settings: Settings) -> int:
    """A node's seed: the command line's for it, or the run's and what pipeline.yaml adds."""
    return settings.overrides.get(node, {}).get(SEED, settings.seed + pipeline.nodes[node].seed)


def _refuse_overrides(pruned: PrunedPipeline, overrides: Overrides) -> None:
    for node, values in overrides.items():
        if node in pruned.left_out:
            raise ConfigurationError(
                f"--set {node}.{next(iter(values))} changes nothing: {node} is left out ({pruned.left_out[node]}); "
                f"{pruned.remedy(node)}"
            )


def _refuse_unused(pruned: PrunedPipeline, parameters: Mapping[str, Parameters], given: Collection[str]) -> None:
    for node in pruned.pipeline.order:
        read, wired = (_list_there(pipeline, node, given) for pipeline in (pruned.pipeline, pruned.whole))
        for problem in find_unused(parameter_schema(pruned.whole, node), parameters[node], read, wired, node):
            raise ConfigurationError(problem)


def _list_there(pipeline: Pipeline, node: str, given: Collection[str]) -> dict[str, list[str]]:
    """Port -> the references wired to it that there is something for."""
    there = {
        port: [r for r in references if not r.startswith("external.") or r.partition(".")[2] in given]
        for port, references in pipeline.references(node).items()
    }
    return {port: references for port, references in there.items() if references}


def _refuse_options(pruned: PrunedPipeline, options: Mapping[str, str]) -> None:
    for external, option in options.items():
        if (reason := pruned.reason_unread(external)) is not None:
            raise ConfigurationError(f"{option} changes nothing: {reason}")
