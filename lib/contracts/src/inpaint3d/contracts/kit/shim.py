"""The shim in every stage: verify, validate, run, hash, commit. The same as a process, in a container, in a pod.

    python -m inpaint3d.stages.NAME run --store DIR --invocation FILE    do the work, or find it done
    python -m inpaint3d.stages.NAME describe                             ports, schemas, version, as JSON

Events go to standard output as JSON lines; whatever else the stage or its libraries print
goes to standard error.
"""

import argparse
import datetime
import importlib
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO, TypeVar

from pydantic import ValidationError

from inpaint3d.contracts.errors import (
    ConfigurationError,
    DoubtfulError,
    Inpaint3dError,
    find_os_error,
    from_os_error,
)
from inpaint3d.contracts.kit.blame import find_fault
from inpaint3d.contracts.kit.code import code_digest, distribution_of, find_requirements, save_code
from inpaint3d.contracts.kit.confine import confine, die_with_parent
from inpaint3d.contracts.kit.context import Context, Emit, Inputs, Outputs
from inpaint3d.contracts.kit.invocation import Invocation, load_invocation
from inpaint3d.contracts.kit.keys import key_components, run_key
from inpaint3d.contracts.kit.process import (
    announce_threads,
    leave_at_once,
    leave_last_words,
    open_events,
    stop_on_signals,
)
from inpaint3d.contracts.kit.provenance import describe_provenance
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.manifest import Manifest, first_error
from inpaint3d.contracts.models.stage import StageSpec, load_stage
from inpaint3d.contracts.store import Record, Store, open_store

T = TypeVar("T")

STAGE_YAML = "INPAINT3D_STAGE_YAML"


def main() -> None:
    """`inpaint3d-stage`, the entry point of every image: serves the stage whose `stage.yaml` the environment names."""
    if (place := os.environ.get(STAGE_YAML)) is None:
        sys.exit(f"inpaint3d-stage: {STAGE_YAML} is not set; set it to the stage's stage.yaml")
    serve(load_stage(Path(place)).spec.module)


def serve(module: str) -> None:
    """The whole of a stage's `__main__`. Exits with the code of `inpaint3d.contracts.errors`."""
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("describe", help="ports, schemas and version, as JSON")
    run = commands.add_parser("run", help="run the stage, or find its result in the store")
    run.add_argument("--store", required=True, help="a folder, or s3://BUCKET/PREFIX")
    run.add_argument("--invocation", type=Path, required=True)
    run.add_argument(
        "--outputs", type=Path, help="a folder to leave each output's digest in, as a file named by its port"
    )
    options = parser.parse_args()
    if options.command == "describe":
        sys.stdout.write(stage_spec(module).model_dump_json(by_alias=True, indent=2) + "\n")
        return
    # The first process of a container is deaf to what it has no handler for, and imports take seconds.
    signal.signal(signal.SIGTERM, leave_at_once)
    with open_events() as events:
        sys.exit(_run_guarded(module, options.store, options.invocation, options.outputs, events))


def prepare() -> None:
    """Do once, for all stages that are forked, what each would do: build models, read what packages require."""
    for model in (Invocation, Manifest, Record, StageSpec):
        model.model_rebuild()
    find_requirements(distribution_of(__name__.partition(".kit")[0]))


def stage_spec(module: str) -> StageSpec:
    """The stage's `stage.yaml`: beside its source, or where the image says."""
    if place := os.environ.get(STAGE_YAML):
        return load_stage(Path(place))
    package = importlib.import_module(module)
    for folder in Path(str(package.__file__)).parents:
        if (folder / "stage.yaml").is_file():
            return load_stage(folder / "stage.yaml")
    raise ConfigurationError(f"no stage.yaml above {package.__file__}; set {STAGE_YAML} to its path")


def execute(module: str, store: Store, invocation: Invocation, events: TextIO) -> Record:
    """Run a stage under its key, or return what is already there. Errors are the tree of `errors`."""
    spec = stage_spec(module)
    components = components_of(module, spec, invocation)
    key = run_key(components)
    with store.shared(), store.lock(key):
        if (record := store.lookup(key)) is None:
            store.sweep_tmp()
            save_code(store, module)
            record = _run(module, spec, store, invocation, key, components, events)
    return record


def components_of(module: str, spec: StageSpec, invocation: Invocation) -> dict[str, Any]:
    """All that the key of an invocation is taken over."""
    return key_components(
        spec,
        code=code_digest(module),
        parameters=invocation.parameters,
        inputs=invocation.inputs,
        seed=invocation.seed,
        device=invocation.device,
        stub=invocation.stub,
    )


def _run(
    module: str,
    spec: StageSpec,
    store: Store,
    invocation: Invocation,
    key: Digest,
    components: dict[str, Any],
    events: TextIO,
) -> Record:
    def emit(event: str, **values: Any) -> None:
        events.write(json.dumps({"event": event, "stage": spec.metadata.name, **values}) + "\n")
        events.flush()

    config = config_of(module, spec, invocation.parameters)
    method = _import_method(module, stub=invocation.stub)
    started = datetime.datetime.now(datetime.UTC)

    def attempt() -> tuple[dict[str, Digest], dict[str, Any]]:
        work = store.work_folder(key)
        ctx = Context(seed=invocation.seed, device=invocation.device, threads=invocation.threads, work=work, emit=emit)
        inputs, outputs = Inputs(store, spec, invocation.inputs), Outputs(store, spec)
        try:
            with stop_on_signals(ctx):
                method(config, inputs, outputs, ctx)
                return outputs.store_all(), ctx.timings()
        except Exception as error:
            outputs.discard()
            if not isinstance(error, Inpaint3dError) and (fault := find_fault(error, inputs.opened)) is not None:
                traceback.print_exc()
                raise fault from error
            raise

    produced, timings = _attempt_anew(attempt, store, key, emit)
    record = Record(
        key=key,
        stage=spec.id,
        components=components,
        outputs=produced,
        provenance=describe_provenance(spec, key, components, produced, started),
        timings=timings,
    )
    record = store.commit(record)
    store.drop_work(key)
    return record


def _attempt_anew(attempt: Callable[[], T], store: Store, key: Digest, emit: Emit) -> T:
    """The result of an attempt; where it fails on what an earlier one left, of one more that starts from nothing."""
    resumed = any(store.work_folder(key).iterdir())
    try:
        return attempt()
    except Inpaint3dError:
        raise
    except Exception:
        if not resumed:
            raise
        traceback.print_exc()
        emit("log", message="it failed on what an earlier run had left, which is in quarantine now; it starts anew")
        store.abandon_work(key)
    return attempt()


def config_of(module: str, spec: StageSpec, parameters: dict[str, Any]) -> Any:
    """The stage's `Config` of these parameters; ConfigurationError where it takes no such."""
    config = importlib.import_module(f"{module}.config").Config
    try:
        return config.model_validate(parameters)
    except ValidationError as error:
        known = ", ".join(sorted(config.model_fields))
        raise ConfigurationError(
            f"parameter of {spec.metadata.name}: {first_error(error)}; its parameters are {known}"
        ) from error


def _import_method(module: str, *, stub: bool) -> Any:
    name = "stub" if stub else "run"
    return getattr(importlib.import_module(f"{module}.{name}"), name)


def _run_guarded(module: str, place: str, invocation_file: Path, outputs: Path | None, events: TextIO) -> int:
    """Run, and turn whatever happens into an event and an exit code."""
    # Its name without its stage.yaml, which may be what fails.
    stage = module.rpartition(".")[2].replace("_", "-")

    def say(event: str, **values: Any) -> None:
        events.write(json.dumps({"event": event, "stage": stage, **values}) + "\n")
        events.flush()

    try:
        invocation = load_invocation(invocation_file)
        confine()
        if invocation.die_with_parent:
            die_with_parent()
        announce_threads(invocation.threads)
        record = execute(module, open_store(place), invocation, events)
        if record.doubts and not invocation.accept_doubtful:
            raise DoubtfulError(record.doubts)
        if outputs is not None:
            _write_outputs(outputs, stage_spec(module), record)
    except Inpaint3dError as error:
        failure, trace = error, None
    except OSError as error:
        failure, trace = from_os_error(error), traceback.format_exc()
    except Exception as error:  # the last resort: a bug becomes exit code 1 with its traceback
        failure = find_os_error(error) or Inpaint3dError(f"{type(error).__name__}: {error}")
        trace = traceback.format_exc()
    else:
        say("done", key=record.key, outputs=record.outputs)
        return 0
    if trace is not None:
        sys.stderr.write(trace)
    say("error", kind=failure.kind, message=str(failure), exit_code=failure.exit_code)
    leave_last_words(failure)
    return failure.exit_code


def _write_outputs(folder: Path, spec: StageSpec, record: Record) -> None:
    """One file for each port; that of an optional output that there is not is empty."""
    folder.mkdir(parents=True, exist_ok=True)
    for port in spec.spec.outputs:
        (folder / port).write_text(record.outputs.get(port, ""))
