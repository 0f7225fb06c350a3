"""The code behind a key: real packages' sources, edited in a copy."""

import importlib.metadata
import shutil
import sys

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit import code
from inpaint3d.contracts.models.report import Change
from inpaint3d.contracts.store import FolderStore

D, E = "sha256:" + "a" * 64, "sha256:" + "b" * 64
ERRORS = "src/inpaint3d/contracts/errors.py"


@pytest.fixture
def project(tmp_path):
    """This package, to be edited."""
    here = code._find_project("inpaint3d-contracts")
    return shutil.copytree(here, tmp_path / "contracts", ignore=shutil.ignore_patterns("__pycache__"))


def digests_after(project, path, old, new):
    """Path -> digest of a package's sources before and after an edit of one of them."""
    before = code.digest_sources.__wrapped__(project)
    text = (project / path).read_text()
    assert text.count(old) == 1
    (project / path).write_text(text.replace(old, new))
    return before, code.digest_sources.__wrapped__(project)


def test_a_space_in_a_docstring_changes_nothing(project):
    before, after = digests_after(project, ERRORS, "One exception tree", "One  exception tree")
    assert before == after
    assert before == code.digest_sources(code._find_project("inpaint3d-contracts")), "where it lies does not count"


def test_a_changed_constant_changes_its_file_alone(project):
    before, after = digests_after(project, ERRORS, "exit_code = 75", "exit_code = 76")
    assert [path for path in before if before[path] != after[path]] == [ERRORS]


def test_other_sources_count_by_their_bytes_and_tests_do_not_count(tmp_path):
    here = code._find_project("inpaint3d-kernels")
    project = shutil.copytree(here, tmp_path / "kernels", ignore=shutil.ignore_patterns("__pycache__", "build"))
    source = next(p for p in sorted((project / "csrc").rglob("*.cpp")))
    relative = source.relative_to(project).as_posix()
    first = next(line for line in source.read_text().splitlines() if line)
    before, after = digests_after(project, relative, source.read_text(), source.read_text() + "// " + first)
    assert [path for path in before if before[path] != after[path]] == [relative]
    (project / "tests").mkdir(exist_ok=True)
    (project / "tests" / "test_more.py").write_text("x = 1")
    (project / "src" / "notes.md").write_text("no source")
    (project / "src" / "__pycache__").mkdir()
    (project / "src" / "__pycache__" / "x.py").write_text("x = 1")
    assert code.digest_sources.__wrapped__(project) == after
    (project / "src" / "more.py").write_text("x = 1")
    assert set(code.digest_sources.__wrapped__(project)) == {*after, "src/more.py"}


@pytest.mark.parametrize("kind", ["folder", "bucket"])
def test_a_change_of_code_is_named_by_package_and_file(kind, project, tmp_path, request):
    from inpaint3d.contracts.store.bucket import BucketStore

    bucket = kind == "bucket" and request.getfixturevalue("bucket")
    store = BucketStore(bucket, tmp_path / "cache") if bucket else FolderStore(tmp_path / "store")
    before, after = digests_after(project, ERRORS, "exit_code = 75", "exit_code = 76")
    listings = [
        {"python": "3.11", "numpy": numpy} | {f"inpaint3d-contracts/{path}": d for path, d in digests.items()}
        for numpy, digests in (("2.2", before), ("2.3", after))
    ]
    old, new = (code.save_listing(store, listing) for listing in listings)
    assert code.save_listing(store, listings[0]) == old
    code._listed.clear()
    seed = Change(component="seed", old=0, new=1)
    assert code.name_changed_files((Change(component="code", old=old, new=new), seed), store) == (
        Change(component=f"code.inpaint3d-contracts/{ERRORS}", old=before[ERRORS], new=after[ERRORS]),
        Change(component="code.numpy", old="2.2", new="2.3"),
        seed,
    )


def test_files_that_came_and_went_are_named(tmp_path):
    store = FolderStore(tmp_path)
    old, new = (code.save_listing(store, {"python": "3.11", f"inpaint3d-x/src/{n}.py": D}) for n in "ab")
    changes = code.name_changed_files((Change(component="code", old=old, new=new),), store)
    assert [(c.component, c.old, c.new) for c in changes] == [
        ("code.inpaint3d-x/src/a.py", D, None),
        ("code.inpaint3d-x/src/b.py", None, D),
    ]


def test_another_python_is_named_and_not_every_file_that_it_compiled(tmp_path):
    store = FolderStore(tmp_path)
    old = code.save_listing(store, {"python": "3.11", "inpaint3d-x/src/a.py": D, "inpaint3d-x/src/a.cpp": D})
    new = code.save_listing(store, {"python": "3.12", "inpaint3d-x/src/a.py": E, "inpaint3d-x/src/a.cpp": E})
    changes = code.name_changed_files((Change(component="code", old=old, new=new),), store)
    assert [c.component for c in changes] == ["code.inpaint3d-x/src/a.cpp", "code.python"]


def test_of_an_image_the_digest_is_all_there_is(tmp_path, monkeypatch):
    monkeypatch.setenv(code.IMAGE_DIGEST, D)
    assert code.code_digest("inpaint3d.stages.whatever") == D
    store = FolderStore(tmp_path)
    code.save_code(store, "inpaint3d.stages.whatever")
    assert store.names(code.CODE_FOLDER) == []
    change = Change(component="code", old=E, new=D)
    assert code.name_changed_files((change,), store) == (change,)


def test_the_listing_covers_libraries_but_not_other_packages():
    packages = {name.partition("/")[0] for name in code.list_code("inpaint3d-scene")}
    assert {"python", "inpaint3d-scene", "inpaint3d-contracts", "numpy", "pydantic"} <= packages
    assert not {"torch", "inpaint3d-radiance"} & packages
    assert code.list_code("inpaint3d-scene")["python"] == ".".join(map(str, sys.version_info[:2]))


def test_compiled_sources_reach_the_stages_that_compute_with_them():
    listing = code.list_code("inpaint3d-nerf-pretraining")
    suffixes = {name.rpartition(".")[2] for name in listing if name.startswith("inpaint3d-kernels/csrc/")}
    assert {"cpp", "hpp"} <= suffixes


def test_a_distribution_that_is_not_here_is_a_clear_error():
    with pytest.raises(ConfigurationError, match="inpaint3d-nowhere is not installed"):
        code.list_code("inpaint3d-nowhere")


def test_versions_and_requirements_are_those_that_python_knows():
    metadata = importlib.metadata
    found = code.find_requirements("inpaint3d-scene")
    assert len(found) > 3
    for name in found:
        assert code._read_metadata(name) == (metadata.version(name), tuple(metadata.requires(name) or ()))
