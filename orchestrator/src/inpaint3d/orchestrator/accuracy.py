"""Accuracy of a whole run against the seconds since its start: the curve, its knee, what other ends would have been."""

from collections.abc import Sequence
from typing import Any

from inpaint3d.contracts.models.artifacts import RadianceFieldArtifact
from inpaint3d.contracts.models.report import AccuracyCourse, AccuracySample, RunRecord
from inpaint3d.contracts.store import Store
from inpaint3d.orchestrator.forecast import find_knee, forecast_gain
from inpaint3d.report.charts import Line, line_chart
from inpaint3d.report.page import render

FIELD, SERIES = "radiance-field", "learning_curve"


def follow_accuracy(store: Store, record: RunRecord) -> AccuracyCourse | None:
    """The course of a run: PSNR on held-out pixels over the sum of its stages' seconds; None where nothing has one.

    Stages count in the pipeline's order, cached ones with the seconds of the run that computed them; controls, which
    nobody takes home, and what follows the last field do not count.
    """
    samples: list[AccuracySample] = []
    wall = cpu = 0.0
    for node in record.nodes:
        found = None if node.key is None else store.lookup(node.key, verify=False)
        if found is None or (FIELD in node.outputs and _is_control(store, node.outputs[FIELD])):
            continue
        rows: list[dict[str, Any]] = found.timings.get("series", {}).get(SERIES, []) if FIELD in node.outputs else []
        samples += [
            AccuracySample(
                node=node.node, wall_s=round(wall + r["wall_s"], 1), cpu_s=round(cpu + r["cpu_s"], 1), psnr=r["psnr"]
            )
            for r in rows
            if "psnr" in r
        ]
        wall, cpu = wall + (node.wall_s or 0.0), cpu + (node.cpu_s or 0.0)
    return judge_course(samples) if samples else None


def _is_control(store: Store, digest: str) -> bool:
    return store.open(digest, RadianceFieldArtifact).metadata.label == "continued-reconstruction"


def judge_course(samples: Sequence[AccuracySample]) -> AccuracyCourse:
    """The knee, and what stopping earlier or going on would have meant for the field in hand.

    In hand is the newest field: what was fitted before its masks were known still shows what is to go, and a fresh fit
    begins below it.
    """
    held = _select_in_hand(samples)
    last = held[-1]
    points = [(s.cpu_s, s.psnr) for s in held]
    knee = held[i] if (i := find_knee(points)) is not None else None
    half = max((s for s in held if s.cpu_s <= (held[0].cpu_s + last.cpu_s) / 2), key=lambda s: s.cpu_s)
    own = [(s.cpu_s - held[0].cpu_s, s.psnr) for s in held if s.node == last.node]
    ahead = own[-1][0] - own[0][0]
    gain = forecast_gain(own, ahead)
    course = AccuracyCourse(
        samples=tuple(samples), in_hand_from=held[0].node, knee=knee, half=half, last=last, ahead_s=round(ahead, 1),
        gain_db=gain and round(gain.value, 3), gain_low_db=gain and round(gain.low, 3),
        gain_high_db=gain and round(gain.high, 3), sentence="",
    )  # fmt: skip
    return course.model_copy(update={"sentence": describe_course(course)})


def _select_in_hand(samples: Sequence[AccuracySample]) -> list[AccuracySample]:
    """From the first field that never saw what is to go on; of a run that has none yet, what there is."""
    nodes = list(dict.fromkeys(s.node for s in samples))
    chosen = nodes[1:] or nodes
    return [s for s in samples if s.node in chosen]


def describe_course(course: AccuracyCourse) -> str:
    """What stopping earlier would have cost and going on would buy, in a sentence or two."""
    last = course.last
    parts = [
        f"stopping half way (at {course.half.cpu_s:.0f} CPU s) would have cost {last.psnr - course.half.psnr:.2f} dB"
    ]
    if course.knee is not None and course.knee != last:
        share = course.knee.cpu_s / last.cpu_s
        parts.insert(
            0,
            f"stopping at the knee (at {course.knee.cpu_s:.0f} CPU s, {share:.0%} of the time to the last field) would "
            f"have cost {last.psnr - course.knee.psnr:.2f} dB",
        )
    told = f"PSNR on held-out pixels ended at {last.psnr:.2f} dB after {last.cpu_s:.0f} CPU s: {'; '.join(parts)}."
    if course.gain_db is None:
        return f"{told} Too few scores of {last.node} to tell what going on would buy."
    return (
        f"{told} Going on with {last.node} for another {course.ahead_s:.0f} CPU s would buy about "
        f"{course.gain_db:+.2f} dB (95 %: {course.gain_low_db:+.2f} to {course.gain_high_db:+.2f})."
    )


def render_course(course: AccuracyCourse | None) -> str:
    """The fragment `accuracy and time` of a page; "" where there is no course."""
    if course is None:
        return ""
    nodes = list(dict.fromkeys(s.node for s in course.samples))
    lowest = min(s.psnr for s in course.samples)
    charts = [
        line_chart(
            [
                *(Line(n, [(getattr(s, axis), s.psnr) for s in course.samples if s.node == n]) for n in nodes),
                *(
                    [Line("knee", [(getattr(course.knee, axis), y) for y in (lowest, course.knee.psnr)])]
                    if course.knee
                    else []
                ),
            ],
            f"{title} seconds since the start, stages one after another",
            "PSNR, held-out pixels, dB",
        )
        for axis, title in (("cpu_s", "CPU"), ("wall_s", "wall"))
    ]
    return render("inpaint3d.orchestrator", "accuracy.html.j2", course=course, charts=charts)
