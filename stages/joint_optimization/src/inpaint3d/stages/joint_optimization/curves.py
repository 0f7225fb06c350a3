"""What a run writes down of itself on the way: rows that equal runs repeat byte for byte."""

import math
from pathlib import Path

import torch
from torch import Tensor

from inpaint3d.radiance.artifact import CURVE_COLUMNS, write_curve, write_table
from inpaint3d.stages.joint_optimization.objective import TERMS

TERM_COLUMNS = (
    "step",
    *(f"loss_{name}" for name in TERMS if name not in ("distillation", "hash_decay")),
    *(f"gradient_{name}" for name in TERMS),
    "distillation_over_reconstruction",
    "weight",
    "t",
    "t_low",
    "t_high",
    "t_floored",
    "push",
    "window_span",
    "specular_scale",
)


class Curves:
    """Rows of `learning_curve.csv` and `terms.csv`; NaN stands for an empty cell."""

    def __init__(self) -> None:
        self.curve: list[list[float]] = []
        self.terms: list[list[float]] = []

    def add_point(self, step: int, rays: int, loss: float, psnr: float | None) -> None:
        """A point of the learning curve: rays so far, loss of the step, held-out PSNR in dB where there are views."""
        self.curve.append([step, rays, loss, math.nan if psnr is None else psnr])

    def add_terms(self, step: int, losses: dict[str, float], norms: dict[str, float], **figures: float) -> None:
        """Losses (weighted) and gradient norms by term at a step, and how strongly the prior pushed.

        ValueError for a term or figure that the table has no column for.
        """
        row = {"step": step, **{f"loss_{n}": v for n, v in losses.items() if n != "distillation"}}
        row |= {f"gradient_{n}": v for n, v in norms.items()} | figures
        if "distillation" in norms:
            row["distillation_over_reconstruction"] = norms["distillation"] / norms["reconstruction"]
        if unknown := sorted(set(row) - set(TERM_COLUMNS)):
            raise ValueError(f"terms.csv has no column for {', '.join(unknown)}")
        self.terms.append([row.get(column, math.nan) for column in TERM_COLUMNS])

    @property
    def last_psnr(self) -> float | None:
        """Held-out PSNR of the last point; None where there are no test views."""
        psnr = self.curve[-1][3] if self.curve else math.nan
        return None if math.isnan(psnr) else psnr

    def tensors(self) -> dict[str, Tensor]:
        """For a checkpoint."""
        return {
            "curve": torch.tensor(self.curve, dtype=torch.float64).reshape(-1, len(CURVE_COLUMNS)),
            "terms": torch.tensor(self.terms, dtype=torch.float64).reshape(-1, len(TERM_COLUMNS)),
        }

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """From a checkpoint."""
        self.curve, self.terms = tensors["curve"].tolist(), tensors["terms"].tolist()

    def write(self, folder: Path) -> None:
        """Both tables as CSV."""
        write_curve(folder, self.curve)
        write_table(folder / "terms.csv", TERM_COLUMNS, self.terms)
