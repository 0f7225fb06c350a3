"""Guards taken out one at a time, and whether the related tests notice: `make mutation`.

Guards are found by patterns over the syntax tree (`find_mutants`), and listed by hand where none fits. Each mutant is a
copy of one package's sources with one change; the related tests run on it in a process of its own until one fails.
"""

import argparse
import ast
import itertools
import json
import os
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
RADIANCE, DIFFUSION, SCENE = (f"lib/{n}/src/inpaint3d/{n}" for n in ("radiance", "diffusion", "scene"))
EVALUATION, INGEST, POSES, EXPORT, PRIORS, JOINT = (
    f"stages/{n}/src/inpaint3d/stages/{n}"
    for n in (
        "evaluation",
        "capture_ingest",
        "pose_estimation",
        "usd_export",
        "diffusion_training",
        "joint_optimization",
    )
)
ORCHESTRATOR = "orchestrator/src/inpaint3d/orchestrator"
EFFECTS = f"{SCENE}/effects"
STABILITY = "tests/stability"

# Source -> the tests that are about it, the quickest first.
RELATED = {
    f"{RADIANCE}/volume.py": [f"{STABILITY}/test_rendering.py", "lib/radiance/tests/test_volume.py"],
    f"{RADIANCE}/safe.py": [
        f"{STABILITY}/test_rendering.py", f"{STABILITY}/test_fields.py", "lib/radiance/tests/test_safe.py",
    ],
    f"{RADIANCE}/spacing.py": [f"{STABILITY}/test_rendering.py", "lib/radiance/tests/test_spacing.py"],
    f"{RADIANCE}/losses.py": [f"{STABILITY}/test_rendering.py", "lib/radiance/tests/test_losses.py"],
    f"{RADIANCE}/line_of_sight.py": [f"{STABILITY}/test_rendering.py", "lib/radiance/tests/test_line_of_sight.py"],
    f"{RADIANCE}/backends/reference.py": [
        f"{STABILITY}/test_rendering.py", f"{STABILITY}/test_fields.py", "lib/radiance/tests/test_reference.py",
        "lib/radiance/tests/test_losses.py",
    ],
    f"{RADIANCE}/optim.py": [f"{STABILITY}/test_rendering.py"],
    f"{RADIANCE}/training.py": [f"{STABILITY}/test_rendering.py", "lib/radiance/tests/test_training.py"],
    f"{RADIANCE}/io.py": [f"{STABILITY}/test_fields.py"],
    f"{RADIANCE}/checkpoints.py": [f"{STABILITY}/test_fields.py", f"{STABILITY}/test_faults.py"],
    f"{RADIANCE}/tracing.py": [f"{STABILITY}/test_faults.py"],
    f"{RADIANCE}/artifact.py": [f"{STABILITY}/test_fields.py"],
    f"{RADIANCE}/sizing.py": [f"{STABILITY}/test_fields.py"],
    f"{RADIANCE}/health.py": [f"{STABILITY}/test_fields.py", f"{STABILITY}/test_faults.py"],
    f"{DIFFUSION}/schedules.py": [f"{STABILITY}/test_diffusion.py", "lib/diffusion/tests/test_schedules.py"],
    f"{DIFFUSION}/samplers.py": [f"{STABILITY}/test_diffusion.py", "lib/diffusion/tests/test_samplers.py"],
    f"{DIFFUSION}/distillation.py": [f"{STABILITY}/test_diffusion.py", "lib/diffusion/tests/test_distillation.py"],
    f"{DIFFUSION}/fill.py": [f"{STABILITY}/test_diffusion.py", "lib/diffusion/tests/test_fill.py"],
    f"{DIFFUSION}/judging.py": [f"{STABILITY}/test_diffusion.py"],
    f"{DIFFUSION}/training.py": [f"{STABILITY}/test_prior_faults.py", "lib/diffusion/tests/test_training.py"],
    f"{PRIORS}/teaching.py": [f"{STABILITY}/test_prior_faults.py"],
    f"{PRIORS}/pictures.py": [f"{STABILITY}/test_prior_faults.py", "stages/diffusion_training/tests/test_pictures.py"],
    f"{JOINT}/loop.py": [f"{STABILITY}/test_joint_faults.py"],
    f"{JOINT}/distil.py": [f"{STABILITY}/test_joint_faults.py"],
    f"{SCENE}/windows.py": [f"{STABILITY}/test_geometry.py", "lib/scene/tests/test_windows.py"],
    f"{SCENE}/geometry.py": [f"{STABILITY}/test_geometry.py", "lib/scene/tests/test_geometry.py"],
    f"{SCENE}/reprojection.py": [f"{STABILITY}/test_geometry.py", "lib/scene/tests/test_reprojection.py"],
    f"{SCENE}/masked_views.py": ["lib/scene/tests/test_masked_views.py"],
    f"{SCENE}/normals.py": [f"{STABILITY}/test_geometry.py", "lib/scene/tests/test_normals.py"],
    f"{SCENE}/finite.py": [f"{STABILITY}/test_files.py"],
    f"{SCENE}/image_io.py": [f"{STABILITY}/test_files.py"],
    f"{SCENE}/capture_io.py": [f"{STABILITY}/test_files.py"],
    f"{SCENE}/psnr.py": ["lib/scene/tests/test_psnr.py", f"{STABILITY}/test_metrics.py"],
    f"{EVALUATION}/methods.py": [f"{STABILITY}/test_metrics.py", "stages/evaluation/tests/test_run.py"],
    f"{EVALUATION}/frechet.py": [f"{STABILITY}/test_metrics.py", "stages/evaluation/tests/test_frechet.py"],
    f"{POSES}/normalise.py": [f"{STABILITY}/test_geometry.py", "stages/pose_estimation/tests/test_normalise.py"],
    f"{POSES}/gate.py": [f"{STABILITY}/test_geometry.py", "stages/pose_estimation/tests/test_gate.py"],
    f"{POSES}/model.py": [f"{STABILITY}/test_geometry.py"],
    f"{POSES}/undistort.py": ["stages/pose_estimation/tests/test_undistort.py"],
    f"{POSES}/scale.py": ["stages/pose_estimation/tests/test_scale.py"],
    f"{INGEST}/lenses.py": [f"{STABILITY}/test_geometry.py", "stages/capture_ingest/tests/test_cameras.py"],
    f"{INGEST}/carry.py": ["stages/capture_ingest/tests/test_run.py"],
    f"{EXPORT}/mesh.py": [f"{STABILITY}/test_geometry.py", "stages/usd_export/tests/test_mesh.py"],
    f"{EXPORT}/fusion.py": [f"{STABILITY}/test_geometry.py", "stages/usd_export/tests/test_mesh.py"],
    f"{EXPORT}/soundness.py": ["stages/usd_export/tests/test_usd.py"],
    f"{EXPORT}/texture.py": ["stages/usd_export/tests/test_atlas.py"],
    f"{EXPORT}/atlas.py": ["stages/usd_export/tests/test_atlas.py"],
    f"{EVALUATION}/scores.py": [f"{STABILITY}/test_metrics.py", "stages/evaluation/tests/test_scores.py"],
    f"{EVALUATION}/bench.py": ["stages/evaluation/tests/test_run.py"],
    f"{EVALUATION}/protocols.py": ["stages/evaluation/tests/test_run.py"],
    f"{ORCHESTRATOR}/budget/choice.py": ["orchestrator/tests/test_budget.py"],
    f"{ORCHESTRATOR}/study/points.py": ["orchestrator/tests/test_study.py"],
    **{f"{EFFECTS}/{name}.py": ["lib/scene/tests/test_effects.py"] for name in (
        "blur", "contraction", "evidence", "exposure", "gains", "intervals", "lens_distortion", "rolling_shutter",
        "transients", "view_dependence", "vignetting", "anti_aliasing",
    )},
}  # fmt: skip
# Where every guard that a pattern finds is taken out; elsewhere those that are listed by hand.
BY_PATTERN = [
    f"{RADIANCE}/volume.py", f"{RADIANCE}/safe.py", f"{RADIANCE}/losses.py", f"{RADIANCE}/line_of_sight.py",
    f"{RADIANCE}/optim.py", f"{RADIANCE}/io.py", f"{RADIANCE}/checkpoints.py", f"{RADIANCE}/sizing.py",
    f"{RADIANCE}/training.py", f"{DIFFUSION}/schedules.py", f"{DIFFUSION}/samplers.py", f"{DIFFUSION}/fill.py",
    f"{DIFFUSION}/distillation.py", f"{DIFFUSION}/training.py", f"{EVALUATION}/frechet.py", f"{EVALUATION}/scores.py",
    f"{SCENE}/finite.py", f"{SCENE}/psnr.py", f"{EXPORT}/soundness.py", f"{RADIANCE}/backends/reference.py",
    f"{RADIANCE}/health.py",
]  # fmt: skip
# fmt: off
BY_HAND = [
    (f"{RADIANCE}/volume.py", "F.pad(torch.cumsum(optical_depth[..., :-1], -1), (1, 0))", "torch.cumsum(optical_depth, -1) - optical_depth"),
    (f"{RADIANCE}/volume.py", "reached[:, -1] <= smallest, far, (low + share * (high - low))[:, 0]", "reached[:, -1] > smallest, (low + share * (high - low))[:, 0], far"),
    (f"{RADIANCE}/safe.py", "return grads[0] * value\n", "return grads[0] * value * (value < 3e6)\n"),
    (f"{RADIANCE}/safe.py", "x / largest).square()", "x / 1).square()"),
    (f"{RADIANCE}/losses.py", "torch.hypot(residual, residual.new_tensor(eps))", "torch.sqrt(residual.square() + eps**2)"),
    (f"{RADIANCE}/spacing.py", "1 / ((1 - sdist) / (1 + self.near) + sdist / (1 + self.far)) - 1", "1 / (1 / (1 + self.near) - sdist * (1 / (1 + self.near) - 1 / (1 + self.far))) - 1"),
    (f"{RADIANCE}/spacing.py", "return (p - 1) / p * (premult * x / (1 - p) + 1) ** p", "return (p - 1) / p - (p - 1) / p * (1 - (premult * x / (1 - p) + 1) ** p)"),
    (f"{RADIANCE}/backends/reference.py", "torch.isfinite(second) & ", ""),
    (f"{RADIANCE}/backends/reference.py", " & torch.isfinite(to)", ""),
    (f"{RADIANCE}/backends/reference.py", "mass = weights + torch.finfo(weights.dtype).eps * torch.diff(sdist)", "mass = weights"),
    (f"{RADIANCE}/backends/reference.py", "torch.where(gap <= 0, 1, gap)", "torch.where(gap > 0, gap, 1)"),
    (f"{RADIANCE}/backends/reference.py", ".masked_fill(low.isnan(), 0)", ""),
    (f"{RADIANCE}/backends/reference.py", "(weights + torch.finfo(weights.dtype).eps)", "weights"),
    (f"{RADIANCE}/backends/reference.py", "safe.sigmoid(logits)", "torch.sigmoid(logits)"),
    (f"{RADIANCE}/artifact.py", "~np.isfinite(values)", "np.zeros_like(values, bool)"),
    (f"{RADIANCE}/health.py", "if found := find_non_finite(tensors):", "if found := find_non_finite({}):"),
    (f"{RADIANCE}/health.py", "if optimizer is not None:\n            tensors", "if False:\n            tensors"),
    (f"{RADIANCE}/checkpoints.py", " if halvings <= rollbacks else None", ""),
    (f"{RADIANCE}/checkpoints.py", "    optimizer.halvings = halvings\n", ""),
    (f"{RADIANCE}/tracing.py", "if found := find_non_finite(dict(field.named_parameters())):", "if found := []:"),
    (f"{RADIANCE}/tracing.py", "if not np.isfinite((origin, direction)).all():", "if False:"),
    (f"{JOINT}/loop.py", "if last:\n        check_finite(field, optimizer)", "if False:\n        check_finite(field, optimizer)"),
    (f"{JOINT}/distil.py", 'if found := find_non_finite({"its gradient": inner}):', "if found := []:"),
    (f"{PRIORS}/teaching.py", "if not np.isfinite(loss):", "if False:"),
    (f"{PRIORS}/teaching.py", "lost >= MOST_LOST or ", ""),
    (f"{PRIORS}/teaching.py", " or _find_non_finite(weights):", ":"),
    (f"{PRIORS}/pictures.py", "if broken := int((~np.isfinite(colour[~unknown])).sum()):", "if broken := 0:"),
    (f"{SCENE}/windows.py", "if side > size and not window.sample(hole).any():", "if False:"),
    (f"{SCENE}/windows.py", "if not odds.any():", "if False:"),
    (f"{SCENE}/geometry.py", "if cosine < -1 + 1e-12:", "if False:"),
    (f"{SCENE}/geometry.py", "perpendicular = offset - along[..., None] * directions", "perpendicular = np.sqrt(np.maximum(np.sum(offset**2, -1) - along**2, 0))[..., None]"),
    (f"{SCENE}/geometry.py", "np.where(np.isnan(t0) | np.isnan(t1), -np.inf, np.minimum(t0, t1))", "np.minimum(t0, t1)"),
    (f"{SCENE}/reprojection.py", "surface = np.isfinite(z) & (z > 0)", "surface = z > 0"),
    (f"{SCENE}/reprojection.py", "surface = np.isfinite(z) & (z > 0)", "surface = np.isfinite(z)"),
    (f"{SCENE}/normals.py", "depth = np.where(np.isfinite(depth), depth, np.nan)", "depth = np.asarray(depth)"),
    (f"{SCENE}/normals.py", ", where=length > 0", ""),
    (f"{SCENE}/image_io.py", "if strange := int((~np.isfinite(grey)).sum()):", "if strange := 0:"),
    (f"{SCENE}/image_io.py", "if linear:\n        _check_units(colour, path)", "if False:\n        pass"),
    (f"{SCENE}/image_io.py", "white > MAX_WHITE or ", ""),
    (f"{SCENE}/image_io.py", " or (brightest < MIN_LIGHT and light.any())", ""),
    (f"{SCENE}/image_io.py", " and light.any()", ""),
    (f"{SCENE}/image_io.py", "np.clip(colour, 0, 1)", "colour"),
    (f"{SCENE}/image_io.py", "if strange := int((~np.isfinite(alpha)).sum()):", "if strange := 0:"),
    (f"{SCENE}/image_io.py", "if found := find_non_finite({path.name: image}):", "if found := []:"),
    (f"{SCENE}/capture_io.py", "if not sound:", "if False:"),
    (f"{SCENE}/masked_views.py", "xy[rows, 0].clip(0, hole.shape[1] - 1)", "xy[rows, 0]"),
    (f"{SCENE}/capture_io.py", "if strange := find_non_finite(arrays):", "if strange := []:"),
    (f"{POSES}/gate.py", "np.flatnonzero(distance > FAR * usual).tolist() if usual > 0 else []", "[]"),
    (f"{POSES}/gate.py", "if usual > 0 else []", ""),
    (f"{POSES}/gate.py", "max(ONE_POINT * away, LEAST_EXTENT)", "0.0"),
    (f"{POSES}/scale.py", "np.rad2deg(np.arcsin(np.sqrt(shared)))) < LEAST_SPREAD_DEG", "np.rad2deg(np.arcsin(np.sqrt(shared)))) < 0"),
    (f"{POSES}/undistort.py", "np.clip(at[..., 0], 0, self.lens.width - 1)", "at[..., 0]"),
    (f"{POSES}/undistort.py", "np.clip(at[..., 1], 0, self.lens.height - 1)", "at[..., 1]"),
    (f"{POSES}/scale.py", "if length <= miss:", "if False:"),
    (f"{INGEST}/lenses.py", "if (bend := _bend(lens.model, further, radius)) > STRONGEST_BEND:", "if (bend := 0.0):"),
    (f"{INGEST}/lenses.py", "if not SHORTEST_FOCAL * longest <= min(focal) <= max(focal) <= LONGEST_FOCAL * longest:", "if min(focal) <= 0:"),
    (f"{INGEST}/carry.py", " and low <= value <= high", ""),
    (f"{INGEST}/carry.py", " and np.isfinite(altitude)", ""),
    (f"{POSES}/normalise.py", "origin = np.median(centres, 0)", "origin = np.zeros(3)"),
    (f"{POSES}/model.py", "round_to_digits(pose[:, :3], 1.0)", "round_to_digits(pose[:, :3], np.abs(pose).max())"),
    (f"{POSES}/model.py", "np.maximum(np.abs(xyz).max(-1, keepdims=True, initial=0.0), 1.0)", "max(np.abs(xyz).max(initial=0.0), 1.0)"),
    (f"{EXPORT}/mesh.py", ", where=length > 0", ""),
    (f"{EXPORT}/mesh.py", "1e-9 * np.square(longest)", "1e-9"),
    (f"{EXPORT}/mesh.py", "inside.size == 0 or inside.min() >= 0 or inside.max() <= 0", "inside.size == 0"),
    (f"{EXPORT}/mesh.py", "normals / np.where(length > 0, length, 1.0)", "normals / length"),
    (f"{EXPORT}/fusion.py", "total / np.maximum(count, 1.0)", "total / count"),
    (f"{EXPORT}/fusion.py", "known[at] = np.isfinite(found)", "known[at] = True"),
    (f"{EXPORT}/fusion.py", "np.maximum(weight, 1e-6)", "weight"),
    (f"{EXPORT}/fusion.py", "inside = (z > 0) & ", "inside = "),
    (f"{EXPORT}/soundness.py", "path.is_absolute() or ", ""),
    (f"{EXPORT}/soundness.py", '".." in path.parts or ', ""),
    (f"{EXPORT}/soundness.py", ' or ":" in asset.path', ""),
    (f"{EXPORT}/soundness.py", "if not asset.resolvedPath:", "if False:"),
    (f"{EXPORT}/soundness.py", "not np.allclose(np.asarray(told), np.asarray(found), rtol=1e-5, atol=1e-6)", "False"),
    (f"{EXPORT}/soundness.py", "chosen.SetVariantSelection(variant)", "pass"),
    (f"{EXPORT}/texture.py", "np.maximum(weight, 1e-6)[..., None]", "weight[..., None]"),
    (f"{EXPORT}/texture.py", "common / np.where(own > 0, own, 1.0)", "common / own"),
    (f"{EXPORT}/texture.py", "sound[[0, -1]] = sound[:, [0, -1]] = False", "pass"),
    (f"{EXPORT}/texture.py", "safe_z = np.where(inside, z, 1.0)", "safe_z = z"),
    (f"{EXPORT}/texture.py", "np.minimum(apart / (2 * AGREEMENT**2), 30.0)", "apart / (2 * AGREEMENT**2)"),
    (f"{EXPORT}/texture.py", "np.maximum(agreed.sum(0), 1e-30)[:, None]\n        away", "np.maximum(agreed.sum(0), 1e-12)[:, None]\n        away"),
    (f"{EXPORT}/atlas.py", "size, PADDING", "size, 0"),
    (f"{EVALUATION}/methods.py", "~np.isfinite(values)", "np.isnan(values)"),
    (f"{EVALUATION}/bench.py", "return not any(counts.values())", "return True"),
    (f"{EVALUATION}/protocols.py", "sum(map(math.isnan, found))", "0"),
    (f"{ORCHESTRATOR}/budget/choice.py", "min(1.0, spare / planned)", "spare / planned"),
    (f"{ORCHESTRATOR}/budget/choice.py", "max(pace, spent / planned) if planned else pace", "max(pace, spent / planned)"),
    (f"{ORCHESTRATOR}/budget/choice.py", " or float(parts[1]) == 0", ""),
    (f"{ORCHESTRATOR}/study/points.py", "(other.stages[stage].held_out_psnr or 0.0)", "other.stages[stage].held_out_psnr"),
    (f"{ORCHESTRATOR}/study/points.py", "if reached is None:", "if False:"),
    (f"{EFFECTS}/gains.py", "np.maximum(weight.sum(1), 1e-12)", "weight.sum(1)"),
    (f"{EFFECTS}/gains.py", "(np.median(gains[told]) if told.any() else 0.0)", "np.median(gains[told])"),
    (f"{EFFECTS}/gains.py", ' if total > 0 else float("nan")', ""),
    (f"{EFFECTS}/gains.py", "np.maximum(count, 1)\n", "count\n"),
    (f"{EFFECTS}/evidence.py", "min(2, count - 1)", "2"),
    (f"{EFFECTS}/evidence.py", "(energy[:, 0] + 1e-6) / (energy[:, 1] + 1e-6)", "energy[:, 0] / energy[:, 1]"),
    (f"{EFFECTS}/intervals.py", "folds = folds[np.isfinite(folds)]", "folds = folds[:]"),
    (f"{EFFECTS}/intervals.py", "if len(folds) < 2:", "if False:"),
    (f"{EFFECTS}/rolling_shutter.py", "max((weight[:, None] * s * s).sum(), 1e-12)", "(weight[:, None] * s * s).sum()"),
    (f"{EFFECTS}/rolling_shutter.py", "np.where(z[:, None] > 0, xy, np.nan)", "xy"),
    (f"{EFFECTS}/vignetting.py", "max((weight * dx * dx).sum(), 1e-12)", "(weight * dx * dx).sum()"),
    (f"{EFFECTS}/view_dependence.py", "np.sqrt(max(far_ev**2 - near_ev**2, 0.0))", "np.sqrt(far_ev**2 - near_ev**2)"),
    (f"{EFFECTS}/view_dependence.py", "np.maximum(weight.sum(1), 1e-12)", "weight.sum(1)"),
    (f"{EFFECTS}/transients.py", "np.clip(misses / np.maximum(total, 1), 1e-6, 1 - 1e-6)", "misses / np.maximum(total, 1)"),
    (f"{EFFECTS}/contraction.py", "np.maximum(np.linalg.norm(xyz, axis=-1), 1.0)", "np.linalg.norm(xyz, axis=-1)"),
    (f"{EFFECTS}/contraction.py", "core if reach > FAR_BEYOND * core else reach", "reach"),
    (f"{EFFECTS}/lens_distortion.py", "max(simple.error_px, floor) / max(rich.error_px, floor)", "simple.error_px / rich.error_px"),
]
# fmt: on
EXPLAINED = {
    "samplers.py: torch.expm1(-h) -> (torch.exp((-h)) - 1)": (
        "what it multiplies is added to numbers of about 1, whose own rounding is as large as the digits that are lost"
    ),
}
"""Mutant -> why no test can tell it from the original."""


DID_NOT_RUN = 9
MOST_CALLERS = 200
Calls = dict[str, list[str]]


@dataclass(frozen=True)
class Mutant:
    """A change of one source file: `before` at `offset` becomes `after`; the nth such change of the file."""

    file: str
    line: int
    before: str
    after: str
    offset: int
    nth: int = 0

    @property
    def function(self) -> str:
        """FILE:FUNCTION of the innermost function around the change."""
        around = [
            node
            for node in ast.walk(ast.parse((ROOT / self.file).read_text()))
            if isinstance(node, ast.FunctionDef) and node.lineno <= self.line <= (node.end_lineno or node.lineno)
        ]
        return f"{self.file}:{max(around, key=lambda node: node.lineno).name if around else '<module>'}"

    @property
    def identity(self) -> tuple[str, str, str, int]:
        """What stays the same when other lines of the file come and go."""
        return self.file, self.before, self.after, self.nth

    @property
    def name(self) -> str:
        return f"{Path(self.file).name}: {self.before.strip()} -> {self.after.strip() or 'nothing'}"


def find_mutants() -> list[Mutant]:
    """All guards: those of the patterns, then those by hand. ValueError where one by hand is no longer in its file."""
    found = [mutant for file in BY_PATTERN for mutant in _by_pattern(file)]
    for file, before, after in BY_HAND:
        text = (ROOT / file).read_text()
        if (offset := text.find(before)) < 0:
            raise ValueError(f"{file} no longer has {before!r}; bring the list up to date")
        found.append(Mutant(file, text.count("\n", 0, offset) + 1, before, after, offset))
    return _number(found)


def _number(mutants: list[Mutant]) -> list[Mutant]:
    seen: Counter[tuple[str, str, str]] = Counter()
    numbered: list[Mutant] = []
    for mutant in mutants:
        change = mutant.file, mutant.before, mutant.after
        numbered.append(replace(mutant, nth=seen[change]))
        seen[change] += 1
    return numbered


def _of_row(row: dict[str, Any]) -> Mutant:
    return Mutant(row["file"], row["line"], row["before"], row["after"], 0)


def _by_pattern(file: str) -> Iterator[Mutant]:
    text = (ROOT / file).read_text()
    starts = [0, *itertools.accumulate(len(line.encode()) + 1 for line in text.split("\n"))]
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.expr) or (after := _without_guard(node, text)) is None:
            continue
        before = ast.get_source_segment(text, node) or ""
        offset = len(text.encode()[: starts[node.lineno - 1] + node.col_offset].decode())
        yield Mutant(file, node.lineno, before, after, offset)


def _without_guard(node: ast.AST, text: str) -> str | None:
    """What is left of a guarded expression; None for one that is no guard."""

    def source(part: ast.expr) -> str:
        return f"({ast.get_source_segment(text, part)})"

    if not isinstance(node, ast.Call):
        return None
    name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    constant = [isinstance(a, ast.Constant) for a in node.args]
    if name in ("clamp", "clamp_", "clip") and isinstance(node.func, ast.Attribute):
        of_module = isinstance(node.func.value, ast.Name) and node.func.value.id in ("torch", "np")
        return source(node.args[0] if of_module else node.func.value)
    if name == "expm1":
        return f"(torch.exp({source(node.args[0])}) - 1)"
    if name == "isfinite" and (
        of := [*node.args, *([node.func.value] if isinstance(node.func, ast.Attribute) else [])]
    ):
        return f"({source(of[0])} == {source(of[0])})"
    if name in ("max", "maximum", "min") and len(node.args) == 2 and sum(constant) == 1:
        return source(node.args[constant.index(False)])
    if name == "where" and len(node.args) == 3 and sum(constant[1:]) == 1:
        return source(node.args[1 + constant[1:].index(False)])
    if name in ("check_answer", "check_finite", "check_finite_weights", "find_non_finite"):
        return "[]" if name == "find_non_finite" else source(node.args[0])
    return None


def survives(mutant: Mutant, calls: Calls) -> tuple[bool, float]:
    """Whether all related tests pass on the mutant, and after how many seconds that was known.

    First the tests that call the changed function, the quickest first; where none fails, all that are related.
    """
    begun = time.monotonic()
    source = Path(mutant.file).parts
    package = Path(*source[: source.index("src") + 1])
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / package, copy)
        changed = copy / Path(mutant.file).relative_to(package)
        text = changed.read_text()
        end = mutant.offset + len(mutant.before)
        changed.write_text(text[: mutant.offset] + mutant.after + text[end:])
        callers = calls.get(mutant.function, [])
        alive = all(_run_tests(copy, tests) == 0 for tests in (callers[:MOST_CALLERS], RELATED[mutant.file]) if tests)
    return alive, time.monotonic() - begun


def record_calls(files: set[str]) -> Calls:
    """FILE:FUNCTION -> the tests that call it, the quickest first, of those that are about these files.

    RuntimeError where one fails without any change.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "calls.json"
        tests = sorted({test for file in files for test in RELATED[file]})
        if _run_tests(None, tests, out) != 0:
            raise RuntimeError("the related tests fail without any change; mend them first")
        found = json.loads(out.read_text())
    calls: Calls = {}
    for test, (_, functions) in sorted(found.items(), key=lambda item: item[1][0]):
        for function in functions:
            calls.setdefault(function, []).append(test)
    return calls


class CallRecorder:
    """A plugin of pytest that writes down which functions of RELATED each test calls, and how long it takes."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.found: dict[str, tuple[float, list[str]]] = {}
        self.files = {str(ROOT / file): file for file in RELATED}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        called: set[str] = set()

        def watch(frame: FrameType, event: str, _: object) -> None:
            if event == "call" and (file := self.files.get(frame.f_code.co_filename)):
                called.add(f"{file}:{frame.f_code.co_name}")

        begun = time.monotonic()
        sys.setprofile(watch)
        try:
            return (yield)
        finally:
            sys.setprofile(None)
            self.found[item.nodeid] = (time.monotonic() - begun, sorted(called))

    def pytest_sessionfinish(self) -> None:
        self.out.write_text(json.dumps(self.found))


def _run_tests(sources: Path | None, tests: list[str], calls: Path | None = None) -> int:
    """pytest's exit code, 0 or 1, of these tests in a forked process, with other sources where they are given."""
    child = os.fork()
    if child == 0:
        code = DID_NOT_RUN
        try:
            code = _run_pytest(sources, tests, calls)
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code not in (0, 1):
        raise RuntimeError(f"tests did not run (pytest's exit code {code}): {tests}")
    return code


def _run_pytest(sources: Path | None, tests: list[str], calls: Path | None) -> int:
    os.chdir(ROOT)
    with Path(os.devnull).open("w") as nothing:
        os.dup2(nothing.fileno(), 1)
        os.dup2(nothing.fileno(), 2)
    if sources is not None:
        sys.path.insert(0, str(sources))
    if (namespace := sys.modules.get("inpaint3d")) is not None:
        raise RuntimeError(f"{namespace} was imported before the mutant's sources were in the path")
    plugins = [CallRecorder(calls)] if calls is not None else []
    return int(pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-m", "not slow", *tests], plugins=plugins))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks/results/mutation.json")
    parser.add_argument("--only", default="", help="mutants whose file and name match this; others stay as they are")
    parser.add_argument("--missing", action="store_true", help="only those that are not in the table yet")
    parser.add_argument("--list", action="store_true", help="name them, run nothing")
    options = parser.parse_args()
    mutants = find_mutants()
    known = json.loads(options.out.read_text())["rows"] if options.out.exists() else []
    rows = {mutant.identity: row for mutant, row in zip(_number([_of_row(row) for row in known]), known, strict=True)}
    chosen = [m for m in mutants if re.search(options.only, f"{m.file} {m.name}")]
    chosen = [m for m in chosen if not (options.missing and m.identity in rows)]
    if options.list:
        print("\n".join(f"{m.file}:{m.line} {m.name}" for m in chosen), f"\n{len(chosen)} mutants")
        return
    # What every child needs, imported once; nothing of ours, and nothing that pytest loads as a plugin.
    for module in ("numpy", "scipy.ndimage", "torch", "cv2", "OpenImageIO"):
        __import__(module)
    calls = record_calls({m.file for m in chosen})
    for number, mutant in enumerate(chosen):
        alive, seconds = survives(mutant, calls)
        said = "SURVIVED" if alive else "killed"
        print(f"{number + 1}/{len(chosen)} {said} {seconds:.0f} s {mutant.name}", flush=True)
        row = {k: v for k, v in asdict(mutant).items() if k not in ("offset", "nth")} | {"survived": alive}
        rows[mutant.identity] = row | ({"explanation": EXPLAINED.get(mutant.name, "")} if alive else {})
        write_table(
            options.out, [rows[m.identity] | {"line": m.line} for m in mutants if m.identity in rows], len(mutants)
        )


def write_table(out: Path, rows: list[dict[str, Any]], mutants: int) -> None:
    """The mutants that there are, with what became of those that were tried."""
    summary = {"mutants": mutants, "run": len(rows), "survived": sum(row["survived"] for row in rows)}
    out.write_text(json.dumps(summary | {"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
