"""What documentation cites is there: files, names, tests, commands, parameters, links. A rename shows here."""

import re

import pytest

from tests.conftest import REPOSITORY
from tests.docs import known

PAGES = sorted(
    f for f in known.tracked() if f.endswith(".md") and not f.startswith(("benchmarks/results", "CHANGELOG"))
)
# Short for folders in docs/conformance.md, which says so.
FOLDERS = {
    **{f"{n}/": f"lib/{n}/src/inpaint3d/{n}/" for n in ("radiance", "diffusion")},
    **{
        f"{short}/": f"stages/{stage}/src/inpaint3d/stages/{stage}/"
        for short, stage in {
            "joint": "joint_optimization",
            "training": "diffusion_training",
            "masks": "mask_authoring",
            "evaluation": "evaluation",
        }.items()
    },
    "orchestrator/": "orchestrator/src/inpaint3d/orchestrator/",
    "lib/perception: ": "lib/perception/src/inpaint3d/perception/",
}
# Made by running something, or somebody else's.
MADE = ("runs/", ".cache/", "data/", "MODELS/", "/data", "/opt", "/tmp", "/store", "keys/", "objects/", "s3://", "http")  # noqa: S108
OTHERS = ("torch.", "np.", "numpy.", "diffusers.", "os.", "argo ", "kubectl", "hf ", "buildah", "podman", "torchrun")
NOT_OURS = {
    "file::test": "how tests are named in a table",
    "test_": "what every test begins with",
    "paper.yaml": "the reader's own",
    "backoffLimit": "Kubernetes'",
    "spec.template.spec.subdomain": "Kubernetes'",
    "pipeline.save_pretrained": "the diffusers library's",
    "DRJIT_LIBLLVM_PATH": "Mitsuba's",
}
FILE = re.compile(r"[\w.*/-]+\.(py|md|yaml|toml|json|j2|cpp|hpp|csv|lock|Containerfile)|[\w.*-]+(/[\w.*-]+)*/")
NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*(\(.*\))?")


def text_of(page):
    return (REPOSITORY / page).read_text()


def spans(page):
    """Inline code of a page."""
    prose = re.sub(r"^```.*?^```", "", text_of(page), flags=re.M | re.S)
    return re.findall(r"(?<!`)`([^`\n]+)`(?!`)", prose)


def command_lines(page):
    """Commands of a page: inline, and lines of its code blocks, continued ones joined."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", text_of(page), flags=re.M | re.S)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    found = [
        re.sub(r"^\s*(\$ |export \S+ )?(\.venv/bin/)?", "", line.split("  #")[0]) for line in [*lines, *spans(page)]
    ]
    return [line for line in found if re.match(r"(inpaint3d|make|python|torchrun)\s", line) or line.startswith("--")]


def long_path(path):
    for short, folder in FOLDERS.items():
        if path.startswith(short) and path not in known.tracked():
            return folder + path.removeprefix(short)
    return path


def exists(path):
    """Whether a path, or a pattern of one (words in capitals stand for anything), is in the repository."""
    shape = re.escape(long_path(path).rstrip("/")).replace(r"\*", "[^/]*")
    shape = re.sub(r"(?<![a-z])[A-Z]{2,}(?![a-z.])", "[^/]*", shape)
    found = any(re.search(rf"(^|/){shape}$", f) for f in known.tracked())
    return found or path.startswith(MADE) or path.rstrip("/").rpartition("/")[2] in known.values()


def wrong_span(span):
    """What is wrong with one citation, or None."""
    if span.startswith((*OTHERS, *MADE)) or span in known.values() or span in NOT_OURS or re.fullmatch("[A-Z]+", span):
        return None
    if match := re.fullmatch(r"(\S+\.py|lib/\w+: \S+\.py): (.+)", span):
        return wrong_definitions(long_path(match[1]), match[2].split(", "))
    if match := re.fullmatch(r"([\w ]*)::(\w+|\*)", span):
        return None if has_test(match[1].split(" ")[-1], match[2]) else f"no test {span}"
    if FILE.fullmatch(span):
        return None if exists(span) else f"no file {span}"
    if NAME.fullmatch(span) and len(span) > 1:
        name = span.partition("(")[0]
        return None if is_name(name) else f"no name {name}"
    return None


def has_test(file, name):
    return any((not file or f == file) and name in (n, "*") for f, n in known.tests())


def wrong_definitions(file, names):
    if file not in known.trees():
        return f"no file {file}"
    missing = [n for n in names if n not in known.definitions(known.trees()[file])]
    return f"{file} has no {', '.join(missing)}" if missing else None


def is_name(name):
    last = name.rpartition(".")[2]
    module = name.replace(".", "/")
    return (
        name in known.defined() | known.values()
        or (("." in name) and last in known.defined() | known.values())
        or any(f.endswith((f"/{module}.py", f"/{module}", f"/{module}/__init__.py")) for f in known.tracked())
    )


def wrong_command(line):
    """What is wrong with one command line, or None."""
    words = line.split()
    if words[0] == "make":
        return None if len(words) < 2 or words[1] in known.targets() else f"no make target {words[1]}"
    if words[0] == "python":
        place = words[2].replace(".", "/") if words[1] == "-m" else words[1].removesuffix(".py")
        found = any(re.search(rf"(^|/){re.escape(place)}(\.py|/__main__\.py)$", f) for f in known.tracked())
        return None if found else f"{line!r}: no module {place}"
    if words[0] in ("inpaint3d", "torchrun") or line.startswith("--"):
        return wrong_option(words) or wrong_setting(line)
    return None


def wrong_option(words):
    if words[0] == "torchrun":
        return None
    options = set().union(*known.commands().values())
    if words[0] == "inpaint3d":
        name = next((n for n in (" ".join(words[1:3]), *words[1:2]) if n in known.commands()), None)
        if name is None:
            return f"no command inpaint3d {words[1] if len(words) > 1 else ''}"
        options = known.commands()[name] if "..." not in words else options
    wrong = [
        w for w in words if re.fullmatch(r"--[a-z][a-z-]*(=.*)?", w) and w.partition("=")[0] not in {*options, "--help"}
    ]
    return f"{' '.join(words)!r} has no option {', '.join(wrong)}" if wrong and not foreign_option(words) else None


def foreign_option(words):
    """Options that stand alone may be of a script of the repository."""
    return words[0].startswith("--") and any(words[0].partition("=")[0] in known.values() for _ in words[:1])


def wrong_setting(line):
    for node, path in re.findall(r"--set[ =]'?([a-z-]+)\.([\w.]+)=", line):
        if node not in known.nodes() or not known.has_parameter(known.nodes()[node], path):
            return f"{line!r}: no parameter {node}.{path}"
    return None


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_cites_is_there(page):
    findings = {wrong_span(s) for s in spans(page)} | {wrong_command(c) for c in command_lines(page)}
    assert findings - {None} == set()


@pytest.mark.parametrize("page", PAGES)
def test_links_of_a_page_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"^```.*?^```", "", text_of(page), flags=re.M | re.S)):
        if target.startswith(("http", "mailto")):
            continue
        path, _, anchor = target.partition("#")
        file = ((REPOSITORY / page).parent / path).resolve() if path else REPOSITORY / page
        assert file.exists(), target
        if anchor:
            titles = re.findall(r"^#+ (.+)$", file.read_text(), re.M)
            assert anchor in {re.sub(r"[^\w\- ]", "", t.lower()).strip().replace(" ", "-") for t in titles}, target


@pytest.mark.parametrize(
    ("span", "finding"),
    [
        ("lib/radiance/no_such.py", "no file lib/radiance/no_such.py"),
        ("radiance/losses.py: charbonnier, no_such", "no_such"),
        ("losses::no_such", "no test losses::no_such"),
        ("no_such_name()", "no name no_such_name"),
        ("radiance/losses.py: charbonnier", None),
        ("NoSuchClass.forward_of_it", "no name"),
    ],
)
def test_a_wrong_citation_is_found(span, finding):
    found = wrong_span(span)
    assert found is None if finding is None else finding in found


@pytest.mark.parametrize(
    ("line", "finding"),
    [
        ("inpaint3d rum PHOTOS", "no command"),
        ("inpaint3d run PHOTOS --maks m", "no option --maks"),
        ("inpaint3d run P --set joint-optimization.no_such=2", "no parameter joint-optimization.no_such"),
        ("inpaint3d run P --set joint-optimization.steps=2", None),
        ("make no-such", "no make target"),
        ("python -m no.such", "no module"),
    ],
)
def test_a_wrong_command_is_found(line, finding):
    found = wrong_command(line)
    assert found is None if finding is None else finding in found
