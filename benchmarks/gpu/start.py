"""Runs `benchmarks.gpu` from a pack, on a machine with Python, torch and no network: python3 start.py --out FOLDER ...

Installs those wheels of the pack whose packages the machine lacks into a folder of their own, then hands over; options
are those of `benchmarks.gpu`. Nothing but Python's own library is imported here.
"""

import importlib.metadata
import os
import subprocess
import sys
import tempfile
from pathlib import Path

PACK = Path(__file__).resolve().parent


def main() -> None:
    site = Path(tempfile.mkdtemp(prefix="wheels-"))
    install_missing(site)
    source = PACK / "source"
    roots = [
        site,
        source,
        *sorted(source.glob("lib/*/src")),
        source / "orchestrator" / "src",
        *sorted(source.glob("stages/*/src")),
    ]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(map(str, [*roots, *filter(None, [os.environ.get("PYTHONPATH")])])),
        "PYTHONUNBUFFERED": "1",
    }
    packed = {"--corpus": PACK / "corpus", "--prior": PACK / "prior", "--scene": PACK / "scene"}
    given = [f"{option}={path}" for option, path in packed.items() if path.is_dir() and option not in sys.argv]
    command = [sys.executable, "-m", "benchmarks.gpu", *given, *sys.argv[1:]]
    print(" ".join(command), flush=True)
    sys.exit(subprocess.run(command, env=environment, check=False).returncode)


def install_missing(site: Path) -> None:
    """The wheels of what the machine has not, into a folder; what fails is said, and left out."""
    missing = [wheel for wheel in sorted((PACK / "wheels").glob("*.whl")) if not is_installed(wheel.name.split("-")[0])]
    if not missing:
        return
    print(f"installing {', '.join(wheel.name for wheel in missing)}", flush=True)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-compile"]
    subprocess.run([*pip, "--target", str(site), *map(str, missing)], check=False)


def is_installed(name: str) -> bool:
    try:
        importlib.metadata.version(name.replace("_", "-"))
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


if __name__ == "__main__":
    main()
