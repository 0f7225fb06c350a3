"""Run scenes: what `inpaint3d run`, `evaluate-dataset` and `plan --effects` do once their command lines are read."""

import contextlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from inpaint3d.contracts.errors import ConfigurationError, Inpaint3dError
from inpaint3d.contracts.models.cluster import Image, ImagesSpec
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.store import Store, open_store
from inpaint3d.contracts.store.workspace import remove
from inpaint3d.orchestrator.intake import name_run
from inpaint3d.orchestrator.options import Environment, Execution, Places, SceneRequest
from inpaint3d.orchestrator.plan import Planner, Selection
from inpaint3d.orchestrator.progress import PROGRESS, Recorded, choose_display
from inpaint3d.orchestrator.publish import REPORT, publish
from inpaint3d.orchestrator.request import ConfiguredRequest
from inpaint3d.orchestrator.run import Scheduler
from inpaint3d.orchestrator.run_folder import check_capture, own_folder
from inpaint3d.orchestrator.runners.container import ContainerRunner, find_engine
from inpaint3d.orchestrator.runners.process import ProcessRunner, Runner
from inpaint3d.orchestrator.saved_mask import command_to_edit, path_of, use_saved
from inpaint3d.orchestrator.tables import printable

Scene = tuple[Path, str | None]
"""A capture, and the name that its run is given."""


@dataclass(frozen=True)
class SceneRunner:
    """Runs scenes, each in the folder of its name. The store and images.yaml are opened when they are first needed."""

    places: Places
    environment: Environment
    execution: Execution

    @cached_property
    def store(self) -> Store:
        return open_store(self.places.store)

    @cached_property
    def images(self) -> Mapping[str, Image] | None:
        """The images whose digests stand for the stages' code, where stages run in them."""
        if self.environment.runner == "process":
            return None
        return load_document(self.environment.images, ImagesSpec)[0].spec

    def folder(self, scene: Scene) -> Path:
        """Where the results of a scene lie."""
        return self.places.runs_dir / name_run(*scene)

    def planner(self, configured: ConfiguredRequest, scene: Scene) -> Planner:
        """What a scene's run would do; its externals are taken into the store."""
        return configured.planner(self.store, *scene, self.images)

    def run(self, configured: ConfiguredRequest, selection: Selection, scene: Scene) -> tuple[RunRecord, int]:
        """Run a scene, leave its results, say how it ended; the record and the exit code."""
        folder, store, runner = self.folder(scene), self.store, self._make_runner()
        with own_folder(folder, wait=self.execution.wait), store.shared():
            planner = self.planner(configured, scene)
            check_capture(planner, replace=self.execution.replace)
            record = self._carry_out(planner, selection, folder, runner)
        code = _conclude(record, folder)
        say(f"Report: {folder / REPORT}")
        if record.status == "waiting":
            say(
                f"{record.name}: `{command_to_edit(record.name, self.places)}` opens a page for it; then run this again"
            )
        return record, code

    def _make_runner(self) -> Runner:
        if self.images is None:
            return ProcessRunner()
        return ContainerRunner(find_engine(self.environment.engine), self.images)

    def _carry_out(self, planner: Planner, selection: Selection, folder: Path, runner: Runner) -> RunRecord:
        if planner.mask is not None and planner.mask == path_of(folder):
            say(f"{planner.name}: what is to go is what {planner.mask} says")
        if left_out := planner.configured.left_out:
            said = ", ".join(f"{node} ({reason})" for node, reason in left_out.items())
            say(f"{planner.name}: left out: {said}")
        scheduler = Scheduler(
            planner,
            selection,
            Recorded(choose_display(self.execution.log_format, planner.pipeline.order), folder / PROGRESS),
            folder,
            runner,
            accept_doubtful=self.execution.accept_doubtful,
            command=("inpaint3d", *sys.argv[1:]),
        )
        remove(folder / REPORT)  # a run that is killed leaves none: that of an earlier one would speak for it
        try:
            record = scheduler.run()
        except BaseException:
            with contextlib.suppress(Inpaint3dError, OSError):  # why the run ended counts, not what could not be shown
                publish(planner.store, scheduler.record, folder)
            raise
        publish(planner.store, record, folder)
        return record


def run_scenes(runner: SceneRunner, request: SceneRequest, selection: Selection, scenes: Sequence[Scene]) -> int:
    """Run scenes one after another, each request checked before the first starts; the gravest exit code."""
    configured = [ConfiguredRequest(use_saved(request, runner.folder(scene)), selection) for scene in scenes]
    codes: list[int] = []
    for scene, asked in zip(scenes, configured, strict=True):
        record, code = runner.run(asked, selection, scene)
        codes.append(code)
        if record.status == "stopped":
            break  # whoever stopped this scene meant the others too
    return max(codes)


def say(line: str) -> None:
    """A line for a person, on standard error."""
    sys.stderr.write(printable(line) + "\n")


def _conclude(record: RunRecord, folder: Path) -> int:
    """Say how a run ended; returns its exit code."""
    ran = [n.node for n in record.nodes if n.status == "done"]
    failed = [n for n in record.nodes if n.status in ("failed", "waiting", "stopped")]
    if record.status == "done":
        what = f"ran {', '.join(ran)}" if ran else "nothing to be done: everything is up to date"
        say(f"{record.name}: {what}. Results: {folder}")
        return 0
    for node in failed:
        say(f"{record.name}: {node.node} {node.status}: {node.error}")
    if failed:
        return max(n.exit_code or 1 for n in failed)
    blocked = [f"{n.node} ({n.reason})" for n in record.nodes if n.status == "pending"]
    repair = "run again to go on" if record.status == "stopped" else "run those first, or leave out --only and --from"
    say(f"{record.name}: {record.status}; not run: {', '.join(blocked)}; {repair}")
    return 143 if record.status == "stopped" else ConfigurationError.exit_code
