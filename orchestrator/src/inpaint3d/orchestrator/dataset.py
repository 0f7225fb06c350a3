"""Data sets that others have published figures on: which scenes a folder holds, and the table beside theirs."""

import statistics
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inpaint3d.contracts.errors import BadInputError, ConfigurationError

PROTOCOLS = ("spin-nerf", "bbox10-vgg")
METRICS = ("psnr", "ssim", "lpips_vgg", "fd_lite0", "fid")


@dataclass(frozen=True)
class Published:
    """Somebody else's row: its figures, how they were measured, and where they were read.

    Figures under another protocol than ours, or that went through other hands, are no comparison.
    """

    figures: dict[str, float]
    protocol: str
    source: str


@dataclass(frozen=True)
class Dataset:
    """marks: what every scene's folder holds. published: rows of others, by name."""

    preset: str
    marks: tuple[str, ...]
    published: dict[str, Published]


DATASETS = {
    # FID is over Inception features: no figure of ours stands beside it.
    "spin-nerf": Dataset(
        preset="spin-nerf",
        marks=("images_4", "poses_bounds.npy"),
        published={
            "SPIn-NeRF (published)": Published(
                {"psnr": 17.40, "ssim": 0.351, "lpips_vgg": 0.540, "fid": 194.67},
                "spin-nerf: the mask's box grown by 10 %",
                "second-hand: as measured by the authors of Inpaint3D, their table 1",
            ),
            "Inpaint3D (published)": Published(
                {"psnr": 17.37, "ssim": 0.463, "lpips_vgg": 0.515, "fid": 226.04},
                "spin-nerf: the mask's box grown by 10 %",
                "Inpaint3D, table 1",
            ),
            "InstaInpaint (published)": Published(
                {"fid": 84.535}, "unknown", "third-hand: a summary of arXiv:2506.10980 by others; crop not stated there"
            ),
        },
    )
}


@dataclass(frozen=True)
class SceneScore:
    """A scene's figures; none where its run failed or it has no truth."""

    name: str
    method: str | None = None
    figures: dict[str, float] | None = None
    views: int | None = None
    protocol: str | None = None


def find_scenes(dataset: Dataset, folder: Path, chosen: list[str] | None) -> list[Path]:
    """The scenes below a folder in the order of their names, or those chosen of them.

    Raises BadInputError where there is none, ConfigurationError for a chosen one that is not there.
    """
    subfolders = sorted(p for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []
    found = [p for p in subfolders if all((p / mark).exists() for mark in dataset.marks)]
    if not found:
        raise BadInputError(
            f"{folder} holds no scene: no subfolder with {' and '.join(dataset.marks)}; give the data set's top folder"
        )
    names = [p.name for p in found]
    if strange := [name for name in chosen or [] if name not in names]:
        raise ConfigurationError(f"--scene {strange[0]}: {folder} has the scenes {', '.join(names)}")
    return [p for p in found if chosen is None or p.name in chosen]


def read_figures(name: str, report: dict[str, Any]) -> SceneScore:
    """The result's figures in a run's metrics.json: the method that stands first."""
    for protocol in report["protocols"]:
        if protocol["name"] in PROTOCOLS and protocol["metrics"]:
            method = protocol["metrics"][0]["method"]
            own = [m for m in protocol["metrics"] if m["method"] == method]
            figures = {m["name"]: float(m["value"]) for m in own if m["name"] in METRICS}
            return SceneScore(name, method, figures, own[0]["views"], protocol["description"])
    return SceneScore(name, protocol="no truth: its views could not be scored")


def tabulate(dataset: Dataset, scores: list[SceneScore]) -> dict[str, Any]:
    """Scenes, the mean over those that were scored, and the published rows."""
    scored = [s.figures for s in scores if s.figures]
    means = {
        name: statistics.fmean(figures[name] for figures in scored)
        for name in METRICS
        if scored and all(name in figures for figures in scored)
    }
    return {
        "metrics": list(METRICS),
        "scenes": [
            {"name": s.name, "method": s.method, "views": s.views, "figures": s.figures or {}, "protocol": s.protocol}
            for s in scores
        ],
        "mean": {"name": f"mean of {len(scored)} of {len(scores)} scenes", "figures": means},
        "published": [
            {"name": name, "figures": row.figures, "protocol": row.protocol, "source": row.source}
            for name, row in dataset.published.items()
        ],
    }
