"""The page's committed bundle is what its sources say, and fetches nothing from anywhere else."""

import hashlib
import re
import shutil
import subprocess

import pytest

from tests.conftest import REPOSITORY

SOURCES = REPOSITORY / "stages/mask_authoring/page"
BUNDLE = REPOSITORY / "stages/mask_authoring/src/inpaint3d/stages/mask_authoring/page/bundle"
BUILT = {"index.html", "page.js", "page.css", "icon.svg"}


def test_the_bundle_is_of_these_sources():
    line = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "."]
    listed = subprocess.run(line, cwd=SOURCES, capture_output=True, text=True, check=True).stdout.split()
    sums = {name: hashlib.sha256((SOURCES / name).read_bytes()).hexdigest() for name in listed}
    written = dict(reversed(row.split()) for row in (BUNDLE / "SHA256SUMS").read_text().splitlines())
    assert written == sums, "run `make page`"


def test_the_bundle_is_small_and_names_no_other_place():
    assert {path.name for path in BUNDLE.iterdir()} == BUILT | {"SHA256SUMS"}
    assert sum(path.stat().st_size for path in BUNDLE.iterdir()) < 100_000
    for name in BUILT:
        urls = set(re.findall(r"(?:https?:)?//[\w.-]+\.\w+[\w./-]*", (BUNDLE / name).read_text()))
        assert urls <= {"http://www.w3.org/2000/svg"}


def test_building_it_anew_gives_the_same_bytes(tmp_path):
    if shutil.which("npm") is None or not (SOURCES / "node_modules" / "vite").is_dir():
        pytest.skip("npm's packages are not here (`make browser`)")
    line = ["npm", "run", "build", "--", "--outDir", str(tmp_path / "bundle")]
    built = subprocess.run(line, cwd=SOURCES, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    for name in BUILT:
        assert (tmp_path / "bundle" / name).read_bytes() == (BUNDLE / name).read_bytes(), name
