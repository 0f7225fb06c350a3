"""The table in words: mean and spread over the seeds, what the rule says, and what an earlier table said."""

from collections.abc import Iterator
from typing import Any

from benchmarks.joint.rows import (
    BASELINES,
    CHANGES,
    ESTIMATORS,
    FIGURES,
    HOLES,
    ROWS,
    RULE,
    RULED,
    Figures,
    Measured,
    mean,
    spread,
)

FORMATS = {"psnr": ".2f", "fd_lite0": ".0f", "gradient_share": ".2f", "wall_s": ".0f", "cpu_s": ".0f"}
COMPARED = ("psnr", "ssim", "lpips_vgg")


def table(result: dict[str, Any], earlier: dict[str, Any]) -> str:
    """The file in words; earlier: a file of the same rows, compared with it, or nothing."""
    lines = [
        "Mean ± standard deviation over the seeds. `wall_s`, `cpu_s`: seconds of view-completion (where the row fits "
        "completed views) and joint-optimization, "
        f"{result['machine']['cores']} cores of the row's processor. `code`: the commits that the row was measured at.",
        "",
    ]
    measured: Measured = result["measured"]
    for scene, rows in measured.items():
        lines += [f"{scene}: {HOLES[scene]}", "", *_tabulate(rows), ""]
    lines += _compare(measured, earlier.get("measured", {}))
    if step := result["sds_step"]:
        lines += [f"A step of `sds` takes {step['ratio']:.2f} times what its render and its prior take (cost.py).", ""]
    ruled = [measured.get(scene, {}) for scene in RULED]
    if all(row in rows for rows in ruled for row in (*BASELINES, *ESTIMATORS)):
        lines += _apply_rule(result["default"])
    return "\n".join(lines).rstrip()


def _tabulate(rows: dict[str, list[Figures]]) -> Iterator[str]:
    names = (*FIGURES, "wall_s", "cpu_s")
    yield f"| row | seeds | {' | '.join(names)} | processor | code |"
    yield "|---" * (len(names) + 4) + "|"
    for row in (r for r in ROWS if r in rows):
        cells = [cell(rows[row], name) for name in names]
        processors = ", ".join(sorted({str(run["processor"]) for run in rows[row]}))
        commits = ", ".join(_list_commits({row: rows[row]}))
        yield f"| {row} | {len(rows[row])} | {' | '.join(cells)} | {processors} | {commits} |"


def _list_commits(rows: dict[str, list[Figures]]) -> list[str]:
    return sorted({str(run["commit"])[:7] for runs in rows.values() for run in runs})


def _compare(measured: Measured, earlier: Measured) -> Iterator[str]:
    """What became of each row that both have, beside the larger of the two spreads over seeds."""
    for scene, rows in measured.items():
        both = [row for row in ROWS if row in rows and row in earlier.get(scene, {})]
        if not both:
            continue
        yield f"{scene}, earlier -> now, and the larger spread of the two; `*`: the means differ by more:"
        yield ""
        if (changed := CHANGES.get(scene)) is not None:
            yield f"{changed}."
            yield ""
        yield f"| row | seeds | {' | '.join(COMPARED)} | code |"
        yield "|---" * (len(COMPARED) + 3) + "|"
        for row in both:
            old, new = earlier[scene][row], rows[row]
            cells = [_set_beside(old, new, name) for name in COMPARED]
            codes = " -> ".join(", ".join(_list_commits({row: runs})) for runs in (old, new))
            yield f"| {row} | {len(old)}, {len(new)} | {' | '.join(cells)} | {codes} |"
        yield ""


def _set_beside(old: list[Figures], new: list[Figures], name: str) -> str:
    form, noise = FORMATS.get(name, ".3f"), max(spread(old, name), spread(new, name))
    mark = "*" if abs(mean(new, name) - mean(old, name)) > noise else ""
    return f"{mean(old, name):{form}} -> {mean(new, name):{form}}, {noise:{form}}{mark}"


def _apply_rule(default: dict[str, Any]) -> list[str]:
    shortfalls = [f"- {shortfall}" for shortfall in default["shortfalls"]] or ["- nothing"]
    return [f"Rule: {RULE}", "", f"By it the default is `{default['row']}`. What it does not reach:", "", *shortfalls]


def cell(runs: list[Figures], name: str) -> str:
    """Mean and, of several seeds, spread."""
    form = FORMATS.get(name, ".3f")
    spread_of = f" ± {spread(runs, name):{form}}" if len(runs) > 1 else ""
    return f"{mean(runs, name):{form}}{spread_of}"
