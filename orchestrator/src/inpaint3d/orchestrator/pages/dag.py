"""The pipeline of a run as a drawing: nodes in layers from top to bottom, an arrow for each result that is read."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from inpaint3d.contracts.models.report import NodeRun
from inpaint3d.report.page import render

BOX_WIDTH, BOX_HEIGHT = 230, 44
GAP_X, GAP_Y = 26, 22


@dataclass(frozen=True)
class Box:
    """A node; x, y of its top left corner. `share`: its part of the time of the longest node."""

    node: str
    status: str
    note: str
    x: float
    y: float
    share: float


def draw_dag(nodes: Sequence[NodeRun]) -> str:
    """An <svg> of the nodes that belong to the run; "" where a record does not say what reads what."""
    part = [n for n in nodes if n.status != "left-out"]
    if not any(n.after for n in part):
        return ""
    layers = _arrange(part)
    width = max(len(layer) for layer in layers) * (BOX_WIDTH + GAP_X) - GAP_X
    longest = max((n.wall_s or 0.0 for n in part), default=0.0) or 1.0
    boxes = {
        n.node: Box(n.node, n.status, _describe(n), x, row * (BOX_HEIGHT + GAP_Y), (n.wall_s or 0.0) / longest)
        for row, layer in enumerate(layers)
        for n, x in zip(layer, _spread(len(layer), width), strict=True)
    }
    arrows = [(boxes[a], boxes[n.node]) for n in part for a in _find_needed(n, part) if a in boxes]
    height = len(layers) * (BOX_HEIGHT + GAP_Y) - GAP_Y
    size = {"width": width, "height": height, "box_width": BOX_WIDTH, "box_height": BOX_HEIGHT}
    return render("inpaint3d.orchestrator.pages", "dag.html.j2", boxes=list(boxes.values()), arrows=arrows, **size)


def _arrange(nodes: Sequence[NodeRun]) -> list[list[NodeRun]]:
    """Each node one layer below the lowest of what it reads."""
    depth: dict[str, int] = {}
    for n in nodes:  # in the pipeline's order: what is read comes first
        depth[n.node] = 1 + max((depth[a] for a in n.after if a in depth), default=-1)
    return [[n for n in nodes if depth[n.node] == d] for d in range(max(depth.values()) + 1)]


def _spread(count: int, width: float) -> list[float]:
    start = (width - count * (BOX_WIDTH + GAP_X) + GAP_X) / 2
    return [start + i * (BOX_WIDTH + GAP_X) for i in range(count)]


def _find_needed(node: NodeRun, nodes: Sequence[NodeRun]) -> list[str]:
    """Of what a node reads, what nothing else that it reads was made from: the rest follows, and hides the way."""
    before = {n.node: set(n.after) for n in nodes}
    return [a for a in node.after if not any(a in _collect(other, before) for other in node.after if other != a)]


def _collect(node: str, before: Mapping[str, set[str]]) -> set[str]:
    found = set(before.get(node, ()))
    return found.union(*(_collect(a, before) for a in found))


def _describe(node: NodeRun) -> str:
    return node.status if node.wall_s is None else f"{node.status} · {format_seconds(node.wall_s)}"


def format_seconds(seconds: float) -> str:
    """0.4 s, 58 s, 2 min 20 s, 1 h 05 min."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    return (
        f"{whole // 60} min {whole % 60:02d} s" if whole < 3600 else f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    )
