"""nerfstudio's nerfacto, built from its classes, on the views that scene.py wrote: `nerfacto.py VIEWS rate|curve ...`.

Prints one JSON object. Runs in the environment of this folder's lock, outside the workspace. Optimisers, rates and
schedules are copied from nerfstudio's method "nerfacto" (configs/method_configs.py imports all of nerfstudio); mixed
precision is off, as nerfstudio itself turns it off on a CPU.
"""

# pyright: reportMissingImports=false, reportMissingTypeStubs=false
import argparse
import json
import math
import re
import time
import warnings
from pathlib import Path

import numpy as np
import torch

# torch's, on how nerfstudio names torch.amp and indexes tensors.
warnings.filterwarnings("ignore", category=FutureWarning)
warnings.filterwarnings("ignore", message="Using a non-tuple sequence", category=UserWarning)

import torchmetrics.image.lpip as lpip  # noqa: E402
from nerfstudio.cameras.camera_optimizers import CameraOptimizerConfig  # noqa: E402
from nerfstudio.cameras.camera_utils import auto_orient_and_center_poses  # noqa: E402
from nerfstudio.cameras.cameras import Cameras  # noqa: E402
from nerfstudio.cameras.rays import RayBundle  # noqa: E402
from nerfstudio.data.scene_box import SceneBox  # noqa: E402
from nerfstudio.engine.optimizers import AdamOptimizerConfig  # noqa: E402
from nerfstudio.engine.schedulers import ExponentialDecaySchedulerConfig  # noqa: E402
from nerfstudio.model_components.ray_generators import RayGenerator  # noqa: E402
from nerfstudio.models.nerfacto import NerfactoModelConfig  # noqa: E402

RATES = {
    "proposal_networks": (1e-2, 1e-4, 200_000),
    "fields": (1e-2, 1e-4, 200_000),
    "camera_opt": (1e-3, 1e-4, 5_000),
}
EVAL_RAYS = 4096


class NoLpips(torch.nn.Module):
    """The model makes this metric when it is built; the real one downloads weights, and nothing here asks for it."""

    def __init__(self, normalize: bool) -> None:  # noqa: ARG002 - the model says it by name
        super().__init__()


class Peer:
    """The model, its optimisers, and the views."""

    def __init__(self, views: Path, seed: int) -> None:
        torch.manual_seed(seed)
        data = np.load(views)
        self.data = {name: torch.from_numpy(np.asarray(data[name])) for name in data.files}
        self.rays = RayGenerator(place_cameras(self.data))
        config = NerfactoModelConfig(
            implementation="torch",
            average_init_density=0.01,
            camera_optimizer=CameraOptimizerConfig(mode="SO3xR3"),
        )
        lpip.LearnedPerceptualImagePatchSimilarity = NoLpips
        box = SceneBox(aabb=torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]))
        self.model = config.setup(scene_box=box, num_train_data=int(self.data["training_views"]))
        groups = self.model.get_param_groups()
        self.optimizers = {
            name: AdamOptimizerConfig(lr=RATES[name][0], eps=1e-15).setup(groups[name]) for name in RATES
        }
        self.schedulers = [
            ExponentialDecaySchedulerConfig(lr_final=final, max_steps=steps)
            .setup()
            .get_scheduler(self.optimizers[name], initial)
            for name, (initial, final, steps) in RATES.items()
        ]
        self.before, self.after = (call.func for call in self.model.get_training_callbacks(None))
        self.step = 0

    def bundle(self, part: str, chosen: torch.Tensor) -> tuple[RayBundle, torch.Tensor]:
        """Rays and colours of some of the pixels."""
        view, yx = self.data[f"{part}_view"][chosen], self.data[f"{part}_yx"][chosen].long()
        rays = self.rays(torch.cat([view[:, None], yx], 1))
        return rays, self.data[f"{part}_rgb"][chosen].float() / 255

    def train(self, rays: int) -> None:
        """One iteration, as nerfstudio's trainer does it."""
        self.model.train()
        self.before(self.step)
        for optimizer in self.optimizers.values():
            optimizer.zero_grad()
        bundle, rgb = self.bundle("train", torch.randint(len(self.data["train_view"]), (rays,)))
        outputs, batch = self.model(bundle), {"image": rgb}
        metrics = self.model.get_metrics_dict(outputs, batch)
        torch.stack(list(self.model.get_loss_dict(outputs, batch, metrics).values())).sum().backward()
        for optimizer in self.optimizers.values():
            optimizer.step()
        for scheduler in self.schedulers:
            scheduler.step()
        self.after(self.step)
        self.step += 1

    @torch.no_grad()
    def psnr(self) -> float:
        """Mean over test views of the PSNR in dB."""
        self.model.eval()
        parts = []
        for chosen in torch.arange(len(self.data["test_view"])).split(EVAL_RAYS):
            bundle, rgb = self.bundle("test", chosen)
            parts.append((self.model(bundle)["rgb"].clamp(0, 1) - rgb).square().mean(-1))
        squared, view = torch.cat(parts).double(), self.data["test_view"]
        return float(np.mean([-10 * math.log10(squared[view == v].mean()) for v in view.unique()]))


def place_cameras(data: dict[str, torch.Tensor]) -> Cameras:
    """The cameras where nerfstudio's own data parser would put them: upright, centred, within the cube."""
    pose = torch.eye(4).repeat(len(data["world_from_cam"]), 1, 1)
    pose[:, :3] = data["world_from_cam"] * torch.tensor([1.0, -1.0, -1.0, 1.0])  # OpenCV's axes to OpenGL's
    pose, _ = auto_orient_and_center_poses(pose, method="up", center_method="poses")
    pose[:, :3, 3] /= pose[:, :3, 3].abs().max()
    pinhole, size = data["pinhole"], data["size"]
    return Cameras(
        camera_to_worlds=pose[:, :3],
        fx=pinhole[:, 0:1], fy=pinhole[:, 1:2], cx=pinhole[:, 2:3], cy=pinhole[:, 3:4],
        width=size[:, 0:1], height=size[:, 1:2],
    )  # fmt: skip


def peak_bytes() -> int:
    """Largest resident set of this process. Not getrusage's, which counts the parent's before exec."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return int(found[1]) * 1024 if found else 0


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("views", type=Path)
    parser.add_argument("what", choices=("rate", "curve"))
    parser.add_argument("--rays", type=int, required=True)
    parser.add_argument("--steps", type=int, default=3, help="rate: iterations after the first")
    parser.add_argument("--limit-s", type=float, default=600, help="curve: CPU seconds")
    parser.add_argument("--every-s", type=float, default=20, help="curve: CPU seconds between points")
    parser.add_argument("--until-db", type=float, default=18.4)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    peer = Peer(options.views, options.seed)
    if options.what == "rate":
        peer.train(options.rays)
        start = time.process_time()
        for _ in range(options.steps):
            peer.train(options.rays)
        cpu_s = time.process_time() - start
        result = {"rays": options.rays, "cpu_s_per_step": cpu_s / options.steps}
        result["rays_per_cpu_s"] = options.rays * options.steps / cpu_s
    else:
        spent, due, curve = 0.0, options.every_s, []
        while spent < options.limit_s and (not curve or curve[-1][1] < options.until_db):
            start = time.process_time()
            peer.train(options.rays)
            spent += time.process_time() - start
            if spent >= due or spent >= options.limit_s:
                curve.append((spent, peer.psnr()))
                due = spent + options.every_s
        result = {"rays": options.rays, "steps": peer.step, "curve": curve}
    print(json.dumps({**result, "peak_memory_bytes": peak_bytes(), "torch": torch.__version__}))


if __name__ == "__main__":
    main()
