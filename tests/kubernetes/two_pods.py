"""What a pod of the Indexed Job does: agree on an address, then torchrun. Arguments: store, job, number of pods.

The first pod leaves its address in the store, so that no cluster DNS is needed. Every pod makes the same small corpus.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from inpaint3d.contracts.store import open_store
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.diffusion_training.corpus import write_corpus

store, job, pods = open_store(sys.argv[1]), sys.argv[2], sys.argv[3]
index = os.environ["JOB_COMPLETION_INDEX"]
work = Path("/cache/work")
noise = np.random.default_rng(0)
for i in range(8):
    write_png(work / "pictures" / f"{i}.png", noise.integers(0, 256, (20, 24, 3), np.uint8))
write_corpus(work / "pictures", work / "corpus", held_out=0.4)
if index == "0":
    store.write(f"meetings/{job}", os.environ["POD_IP"].encode())
while (first := store.read(f"meetings/{job}")) is None:
    time.sleep(0.5)
line = [
    sys.executable, "-m", "torch.distributed.run", "--nnodes", pods, "--nproc-per-node", "1", "--node-rank", index,
    "--master-addr", first.decode(), "--master-port", "29500",
    "-m", "inpaint3d.stages.diffusion_training.pretrain", str(work / "corpus"), str(work / "out"),
    "--config", "/inpaint3d/config.yaml",
]  # fmt: skip
ranks = subprocess.run(line, env=os.environ | {"GLOO_SOCKET_IFNAME": "eth0", "OMP_NUM_THREADS": "1"}, check=False)
if ranks.returncode == 0 and index == "0":
    store.write(f"curves/{job}", (work / "out" / "prior" / "training_curve.csv").read_bytes())
sys.exit(ranks.returncode)
