"""Weights in files that are small enough to be sent: python -m benchmarks.gpu.pieces FOLDER OUT

FOLDER is where `benchmarks.gpu` wrote its results; OUT becomes the diffusion-prior artifact of the prior it trained.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from inpaint3d.contracts.models.artifacts import DiffusionPrior
from inpaint3d.contracts.models.canonical import canonical_json
from inpaint3d.contracts.models.manifest import MANIFEST, build_manifest

WEIGHTS = "weights.safetensors"


def write_pieces(folder: Path, name: str, data: bytes, size: int) -> list[str]:
    """`data` in files NAME.00, NAME.01, ... of at most `size` bytes; those of before go. Returns their names."""
    parts = [data[i : i + size] for i in range(0, len(data), size)]
    for i, part in enumerate(parts):
        staged = folder / f"{name}.new"
        staged.write_bytes(part)
        staged.replace(folder / f"{name}.{i:02d}")
    return [f"{name}.{i:02d}" for i in range(len(parts))]


def join_pieces(folder: Path, name: str) -> bytes:
    """What `write_pieces` wrote."""
    return b"".join(path.read_bytes() for path in sorted(folder.glob(f"{name}.[0-9][0-9]")))


def held_out_of(table: dict[str, Any]) -> dict[str, float]:
    """An artifact's figures of held-out crops from those of the run, where it came so far."""
    rows = {name: row for name, row in table.items() if isinstance(row, dict)}
    found = {f"{figure}_{name}": float(value) for name, row in rows.items() for figure, value in row.items()}
    return {"crops": float(table["crops"]), **found} if rows else {}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    trained = json.loads((options.folder / "results.json").read_text())["prior"]
    options.out.mkdir(parents=True)
    (options.out / WEIGHTS).write_bytes(join_pieces(options.folder, WEIGHTS))
    rows = ["step,loss,held_out_loss", *(",".join(map(str, row)) for row in trained["curve"])]
    (options.out / "training_curve.csv").write_text("\n".join(rows) + "\n")
    metadata = DiffusionPrior.model_validate(trained["metadata"] | {"held_out": held_out_of(trained.get("table", {}))})
    manifest = build_manifest(options.out, "diffusion-prior", metadata)
    (options.out / MANIFEST).write_bytes(canonical_json(manifest.dump()))
    print(f"{options.out}: {trained['metadata']['steps']} steps")


if __name__ == "__main__":
    main()
