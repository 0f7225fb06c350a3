"""What a pod of an Indexed Job does: agree on an address, then torchrun. Arguments: store, job, number of pods, what.

The first pod leaves its address in the store, so that no cluster DNS is needed. `what` is `training` (every pod makes
the same small corpus; the first leaves the curve in the store) or `joint` (the stage leaves its result there itself).
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from inpaint3d.contracts.store import Store, open_store

HERE, WORK = Path(__file__).parent, Path("/cache/work")


def main(place: str, job: str, pods: str, what: str) -> int:
    store, index = open_store(place), os.environ["JOB_COMPLETION_INDEX"]
    line = [
        sys.executable, "-m", "torch.distributed.run", "--nnodes", pods, "--nproc-per-node", "1", "--node-rank", index,
        "--master-addr", first_address(store, job, index), "--master-port", "29500", "-m",
        *(training() if what == "training" else joint(place)),
    ]  # fmt: skip
    ranks = subprocess.run(line, env=os.environ | {"GLOO_SOCKET_IFNAME": "eth0", "OMP_NUM_THREADS": "1"}, check=False)
    if ranks.returncode == 0 and index == "0" and what == "training":
        store.write(f"curves/{job}", (WORK / "out" / "prior" / "training_curve.csv").read_bytes())
    return ranks.returncode


def first_address(store: Store, job: str, index: str) -> str:
    if index == "0":
        store.write(f"meetings/{job}", os.environ["POD_IP"].encode())
    while (address := store.read(f"meetings/{job}")) is None:
        time.sleep(0.5)
    return address.decode()


def training() -> list[str]:
    from inpaint3d.scene.image_io import write_png
    from inpaint3d.stages.diffusion_training.corpus import write_corpus

    noise = np.random.default_rng(0)
    for i in range(8):
        write_png(WORK / "pictures" / f"{i}.png", noise.integers(0, 256, (20, 24, 3), np.uint8))
    write_corpus(WORK / "pictures", WORK / "corpus", held_out=0.4)
    module = "inpaint3d.stages.diffusion_training.pretrain"
    return [module, str(WORK / "corpus"), str(WORK / "out"), "--config", str(HERE / "config.yaml")]


def joint(place: str) -> list[str]:
    module = "inpaint3d.stages.joint_optimization.rank"
    return [module, "run", "--store", place, "--invocation", str(HERE / "invocation")]


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
