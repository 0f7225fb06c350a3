"""What a careful cluster refuses of manifests, and what would be regretted.

Nobody is root, nothing is written outside volumes, no secret stands in clear, what runs is pinned; Argo's own
containers pass the `restricted` pod security standard and quotas too; pods may report to Argo; nothing stays for ever.
"""

import json
import re
from collections.abc import Iterator

from inpaint3d.orchestrator.emit.documents import Document
from inpaint3d.orchestrator.emit.service_account import REPORTS

SECRET = re.compile(r"SECRET|TOKEN|PASSWORD|ACCESS_KEY", re.IGNORECASE)
PINNED = re.compile(r"^sha256:[0-9a-f]{64}$")
ACCOUNT_KINDS = ("ServiceAccount", "Role", "RoleBinding")


class View:
    """A WorkflowTemplate by its parts."""

    def __init__(self, document: Document) -> None:
        self.spec: Document = document["spec"]
        self.templates: dict[str, Document] = {t["name"]: t for t in self.spec["templates"]}

    def tasks(self) -> Iterator[tuple[str, Document]]:
        for name, template in self.templates.items():
            for task in template.get("dag", {}).get("tasks", []):
                yield name, task

    def containers(self) -> Iterator[tuple[str, Document]]:
        return ((name, t) for name, t in self.templates.items() if "container" in t)


def check_policy(view: View, documents: list[Document]) -> Iterator[str]:
    """`where: what` of all that is wrong."""
    yield from _check_pod_policy(view)
    yield from _check_whole_policy(view)
    yield from _may_report(view, documents)


def _check_whole_policy(view: View) -> Iterator[str]:
    """What holds for every pod of the template, and for what Argo adds to it."""
    patch: Document = json.loads(view.spec.get("podSpecPatch", "{}"))
    for kind, wanted in (("initContainers", "init"), ("containers", "wait")):
        added: list[Document] = [c for c in patch.get(kind, []) if c.get("name") == wanted]
        if not added:
            yield f"podSpecPatch: leaves Argo's container {wanted} as a restricted namespace and a quota refuse it"
        for container in added:
            yield from find_unrestricted(f"podSpecPatch: {wanted}", container)
    if "secondsAfterCompletion" not in view.spec.get("ttlStrategy", {}):
        yield "ttlStrategy: Workflows that have ended would stay for ever"
    if "strategy" not in view.spec.get("podGC", {}):
        yield "podGC: pods that have ended would stay for ever"


def find_unrestricted(at: str, container: Document) -> Iterator[str]:
    """What of the `restricted` pod security standard, and of a quota on requests and limits, a container does not keep.

    https://kubernetes.io/docs/concepts/security/pod-security-standards/
    """
    security: Document = container.get("securityContext", {})
    for name, value in {"runAsNonRoot": True, "allowPrivilegeEscalation": False}.items():
        if security.get(name) is not value:
            yield f"{at}: {name} is not {value}"
    if security.get("runAsUser") == 0:
        yield f"{at}: runs as root"
    if security.get("capabilities", {}).get("drop") != ["ALL"] or security["capabilities"].get("add"):
        yield f"{at}: does not drop all capabilities"
    if security.get("seccompProfile", {}).get("type") != "RuntimeDefault":
        yield f"{at}: seccompProfile is not RuntimeDefault"
    for side in ("requests", "limits"):
        for resource in ("cpu", "memory"):
            if resource not in container.get("resources", {}).get(side, {}):
                yield f"{at}: has no {resource} under resources.{side}, which a quota asks for"


def _may_report(view: View, documents: list[Document]) -> Iterator[str]:
    """Whether an account that these documents make may do what its pods have to; of another nothing is known."""
    wanted = view.spec.get("serviceAccountName")
    if not wanted:
        yield "serviceAccountName: none is named, and the namespace's default account may not report to Argo"
        return
    made = {d["kind"]: d for d in documents if d["kind"] in ACCOUNT_KINDS}
    if not made:
        return
    if made.get("ServiceAccount", {}).get("metadata", {}).get("name") != wanted:
        yield f"serviceAccountName: is {wanted}, but the ServiceAccount here is another"
    if REPORTS not in made.get("Role", {}).get("rules", []):
        yield f"Role: does not let {wanted} create and patch workflowtaskresults; every pod would end in an error"
    subjects: list[Document] = made.get("RoleBinding", {}).get("subjects", [])
    if wanted not in {s.get("name") for s in subjects}:
        yield f"RoleBinding: does not give the role to {wanted}"


def _check_pod_policy(view: View) -> Iterator[str]:
    for name, template in view.containers():
        container: Document = template["container"]
        yield from find_unrestricted(name, container)
        if container.get("securityContext", {}).get("readOnlyRootFilesystem") is not True:
            yield f"{name}: readOnlyRootFilesystem is not True"
        if not container.get("command"):
            yield f"{name}: has no command; Argo would have to ask the registry for it"
        for variable in container.get("env", []):
            if SECRET.search(variable["name"]) and "value" in variable:
                yield f"{name}: {variable['name']} stands in clear; refer to a Secret"
            if variable["name"] == "INPAINT3D_IMAGE_DIGEST" and not PINNED.match(variable.get("value", "")):
                yield f"{name}: {variable.get('value')} is no image digest"
        if "INPAINT3D_IMAGE_DIGEST" not in {v["name"] for v in container.get("env", [])}:
            yield f"{name}: does not say which image's digest its keys are made with"
        for artifact in template.get("inputs", {}).get("artifacts", []):
            if artifact.get("mode", 0) & 0o444 != 0o444:
                yield f"{name}: {artifact['name']} cannot be read by a stage that is not root; set mode 0444"
        if "activeDeadlineSeconds" not in template:
            yield f"{name}: has no deadline"
        if "retryStrategy" not in template:
            yield f"{name}: a pod that is lost is not tried again"
        elif "maxDuration" in template["retryStrategy"].get("backoff", {}):
            yield f"{name}: maxDuration counts from the first try's start; activeDeadlineSeconds is that of each try"
