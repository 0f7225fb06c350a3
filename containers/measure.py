"""Write the table of sizes and times in README.md from the images that were built here.

python -m containers.measure [--builds .cache/image-builds.json]
"""

import argparse
import json
import subprocess
from pathlib import Path

from benchmarks.pages import fill_between

HERE = Path(__file__).parent
MB = 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--builds", type=Path, default=HERE.parent / ".cache" / "image-builds.json")
    given = parser.parse_args()
    readme = HERE / "README.md"
    readme.write_text(fill_between(readme.read_text(), "sizes", f"\n{table(json.loads(given.builds.read_text()))}"))


def table(builds: dict[str, dict[str, object]]) -> str:
    """Rows of Markdown: an image, its bytes, those that it does not share with its base, how long it took."""
    rows = ["| image | MB | its own, MB | built in, s |", "|---|---|---|---|"]
    for name, build in sorted(builds.items(), key=lambda item: item[0]):
        whole, base = size(str(build["image"])), size(str(build["base"]))
        rows.append(f"| {name} | {whole / MB:.0f} | {(whole - base) / MB:.0f} | {float(str(build['seconds'])):.0f} |")
    own = sum(size(str(b["image"])) - size(str(b["base"])) for b in builds.values())
    rest = {str(b["base"]) for b in builds.values()} - {str(b["image"]) for b in builds.values()}
    rows.append(f"| all of them on one disk, with their base | {(own + sum(map(size, rest))) / MB:.0f} | | |")
    return "\n".join(rows) + "\n"


def size(image: str) -> int:
    """Bytes of an image's layers, unpacked."""
    line = ["podman", "image", "inspect", "--format", "{{.Size}}", image]
    return int(subprocess.run(line, check=True, capture_output=True, text=True).stdout)


if __name__ == "__main__":
    main()
