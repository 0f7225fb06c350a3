"""Decisions against what was measured: confusion by halves of the captures, what auto costs and saves."""

from collections.abc import Iterable
from typing import Any

Row = dict[str, Any]
WORTH_DB = 0.2
"""An effect is called for where switching it on shows clean held-out views better by more."""
MISSED_DB = 0.5


def chosen_by(row: Row) -> tuple[str, ...]:
    """The effects that were decided to be on."""
    return tuple(name for name, found in row["found"].items() if found["state"] == "on")


def gain_db(row: Row) -> float:
    """Held-out PSNR with the capture's own effect on, minus without."""
    return row["scores"][row["effect"]]["psnr"] - row["scores"][""]["psnr"]


def judge(rows: dict[str, Row]) -> Row:
    """Confusion of each half and of all, by effect; auto against all on and all off."""
    whole = {name: row for name, row in rows.items() if row["effect"] in row["scores"] and "" in row["scores"]}
    halves = {"first half": list(whole.values())[::2], "second half": list(whole.values())[1::2]}
    return {
        "confusion": {half: confuse(some) for half, some in halves.items()},
        "by_effect": {
            effect: confuse(row for row in whole.values() if row["effect"] == effect)
            for effect in sorted({row["effect"] for row in whole.values()})
        },
        "largest_missed_db": max((gain_db(row) for row in whole.values() if not is_on(row)), default=0.0),
        "auto": compare_auto(whole),
    }


def is_on(row: Row) -> bool:
    """Whether the capture's own effect was decided to be on."""
    return row["found"][row["effect"]]["state"] == "on"


def confuse(rows: Iterable[Row]) -> Row:
    """Counts of (decided, worth it); right where both agree, or where it makes no difference beyond WORTH_DB."""
    counts = {"on_and_worth": 0, "on_not_worth": 0, "off_and_worth": 0, "off_not_worth": 0, "on_and_harmful": 0}
    for row in rows:
        gain, on = gain_db(row), is_on(row)
        if on and gain < -WORTH_DB:
            counts["on_and_harmful"] += 1
        counts[f"{'on' if on else 'off'}_{'and' if gain > WORTH_DB else 'not'}_worth"] += 1
    total = sum(counts.values()) - counts["on_and_harmful"]
    right = counts["on_and_worth"] + counts["off_not_worth"]
    return {**counts, "captures": total, "right": round(right / total, 3) if total else None}


def compare_auto(rows: dict[str, Row]) -> Row:
    """Auto against the better of all on and all off (dB), and its share of all on's CPU time."""
    table: Row = {}
    for name, row in rows.items():
        scores = row["scores"]
        all_on = max(scores, key=lambda key: key.count("+"))
        auto = "+".join(sorted(chosen_by(row)))
        if auto in scores and all_on.count("+") > 2:
            table[name] = {
                "auto": auto,
                "auto_psnr": scores[auto]["psnr"],
                "all_on_psnr": scores[all_on]["psnr"],
                "all_off_psnr": scores[""]["psnr"],
                "behind_db": round(max(scores[all_on]["psnr"], scores[""]["psnr"]) - scores[auto]["psnr"], 3),
                "saved": round(1 - scores[auto]["cpu_s"] / scores[all_on]["cpu_s"], 3),
            }
    return table
