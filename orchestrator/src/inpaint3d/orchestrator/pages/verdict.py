"""What a run came to, in a sentence that somebody reads who reads nothing else."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from inpaint3d.contracts.errors import EXIT_CODES
from inpaint3d.contracts.models.artifacts import Evaluation, Metric
from inpaint3d.contracts.models.report import NodeRun, RunRecord

TRUTH, KNOWN = "bbox10-vgg", "held-out-known-pixels"


@dataclass(frozen=True)
class Verdict:
    """`sentence` says it; `points` what to know besides, or how to repair what failed."""

    tone: Literal["good", "warn", "bad"]
    sentence: str
    points: tuple[str, ...] = ()


def judge(record: RunRecord, evaluation: Evaluation | None) -> Verdict:
    """The verdict on a run that has ended; of one that goes on, that it does."""
    if record.status == "running":
        return Verdict("warn", "This run is going on.", ("What is below is what it has come to so far.",))
    if record.status != "done":
        return _describe_failure(record)
    if evaluation is None:
        return Verdict("warn", "The run is done; nothing of it was scored.", ("No evaluation was asked for.",))
    points = tuple(weakness.removeprefix("Weak: ") for weakness in evaluation.weaknesses)
    return Verdict("warn" if record.doubts or points else "good", _describe_success(evaluation), points)


def _describe_failure(record: RunRecord) -> Verdict:
    culprits = [n for n in record.nodes if n.status in ("failed", "waiting", "stopped")]
    verb = {"failed": "failed", "waiting": "waits for a person", "stopped": "was stopped"}[record.status]
    repair = "Then give the same command again: what is done is not computed again."
    if not culprits:
        pending = ", ".join(n.node for n in record.nodes if n.status == "pending")
        why = record.error or (f"nothing made what {pending} needs" if pending else "its record does not say why")
        return Verdict("bad", f"The run {verb}: {why}.", (repair,))
    first = culprits[0]
    points = [f"{n.node}: {_explain_exit(n)}" for n in culprits if n.exit_code is not None]
    tone: Literal["warn", "bad"] = "warn" if record.status == "waiting" else "bad"
    return Verdict(tone, f"The run {verb} at {first.node}: {first.error or record.error}", (*points, repair))


def _explain_exit(node: NodeRun) -> str:
    meaning = EXIT_CODES.get(node.exit_code or 0, "it died; its log says where")
    return f"exit {node.exit_code}, {meaning}"


def _describe_success(evaluation: Evaluation) -> str:
    """In the hole against the truth, then outside it against photos kept back; as far as each was measured."""
    parts = [*_describe_hole(list(find_metrics(evaluation, TRUTH)))]
    if known := {m.name: m for m in find_metrics(evaluation, KNOWN)}.get("psnr"):
        parts.append(f"What was kept meets photos that training never saw at {known.value:.1f} dB.")
    return " ".join(parts or ["The hole is filled; nothing tells how truly."])


def _describe_hole(metrics: Sequence[Metric]) -> Iterator[str]:
    found = {m.name: m for m in metrics}
    if (psnr := found.get("psnr")) is None:
        return
    lpips = f" (LPIPS {found['lpips_vgg'].value:.2f})" if "lpips_vgg" in found else ""
    yield (
        f"The hole is filled, {psnr.value:.1f} dB PSNR{lpips} from what is really there, over {psnr.views} views that "
        "show it."
    )


def find_metrics(evaluation: Evaluation, protocol: str) -> Iterator[Metric]:
    """The figures of the result itself under a protocol: of the method that is listed first and is no baseline."""
    for found in evaluation.protocols:
        if found.name == protocol:
            first = found.metrics[0].method if found.metrics else ""
            yield from (m for m in found.metrics if m.method == first)
