"""One rank of a run on several machines, as torchrun starts it (S12); the first one is the stage itself.

    torchrun TORCHRUN'S OPTIONS -m inpaint3d.stages.joint_optimization.rank run --store STORE --invocation FILE

The parameter `ranks` is the number of processes over all machines. Each reads the inputs from the store; the first
alone writes there, under the key of a run that starts its ranks by itself, since the result is the same.
"""

import argparse
import os
from pathlib import Path

from inpaint3d.contracts.kit.commands import exit_on_error
from inpaint3d.contracts.kit.context import Inputs
from inpaint3d.contracts.kit.invocation import Invocation, load_invocation
from inpaint3d.contracts.kit.keys import run_key
from inpaint3d.contracts.kit.process import announce_threads
from inpaint3d.contracts.kit.shim import components_of, config_of, serve, stage_spec
from inpaint3d.contracts.store import Store, open_store

MODULE = "inpaint3d.stages.joint_optimization"


def main() -> None:
    if os.environ["RANK"] == "0":
        serve(MODULE)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=["run"])
    parser.add_argument("--store", required=True, help="a folder, or s3://BUCKET/PREFIX")
    parser.add_argument("--invocation", type=Path, required=True)
    options, _ = parser.parse_known_args()
    with exit_on_error(f"rank {os.environ['RANK']}"):
        step_along(open_store(options.store), load_invocation(options.invocation))


def step_along(store: Store, invocation: Invocation) -> None:
    """Do a rank's share of every step; nothing where the result is there already. Errors are the tree of `errors`."""
    announce_threads(invocation.threads)
    from inpaint3d.stages.joint_optimization.parallel import follow, join_torchrun
    from inpaint3d.stages.joint_optimization.run import solve

    spec = stage_spec(MODULE)
    config = config_of(MODULE, spec, invocation.parameters)
    key = run_key(components_of(MODULE, spec, invocation))
    with store.shared():
        if store.lookup(key) is not None:
            return
        with join_torchrun(config.ranks, invocation.device) as ranks:
            follow(
                config,
                Inputs(store, spec, invocation.inputs),
                solve,
                ranks,
                seed=invocation.seed,
                device=invocation.device,
                threads=invocation.threads,
                work=store.work_folder(key),
            )


if __name__ == "__main__":
    main()
