"""The pods of emitted manifests as Jobs of a real cluster, which needs no Argo for them.

A Job keeps what the template of a node says of its pod: image, command, security context, volumes, resources. What Argo
would put in by itself (parameters, the invocation's file, retries by an expression) is put in here.
"""

import json
import subprocess
import time
from dataclasses import dataclass, field
from typing import Any

Document = dict[str, Any]
# Retried are pods that were lost or evicted, and the codes that say so: what RETRY in emit/argo.py means.
POLICY = {
    "rules": [
        {"action": "Ignore", "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]},
        {"action": "Count", "onExitCodes": {"operator": "In", "values": [75, 143]}},
        {"action": "FailJob", "onExitCodes": {"operator": "NotIn", "values": [75, 143]}},
    ]
}


def job_of(template: Document, node: str, name: str, values: dict[str, str]) -> list[Document]:
    """A ConfigMap with the node's invocation, and a Job of its pod; `values` are its input parameters."""
    spec = template["spec"]
    found = next(t for t in spec["templates"] if t["name"] == node)
    files = {a["name"]: a for a in found.get("inputs", {}).get("artifacts", [])}
    container = {**found["container"], "name": "main"}
    volumes = [*spec["volumes"], {"name": "files", "configMap": {"name": name, "defaultMode": 0o444}}]
    mounts = [{"name": "files", "mountPath": a["path"], "subPath": n, "readOnly": True} for n, a in files.items()]
    container["volumeMounts"] = [*container["volumeMounts"], *mounts]
    data = {n: filled(a["raw"]["data"], values) for n, a in files.items()}
    pod = {
        "restartPolicy": "Never",
        "automountServiceAccountToken": False,
        "securityContext": spec["securityContext"],
        "volumes": volumes,
        "containers": [container],
    }
    limit = int(found["retryStrategy"]["limit"])
    body = {"backoffLimit": limit, "podFailurePolicy": POLICY, "template": {"spec": pod}}
    return [
        {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": name}, "data": data},
        {"apiVersion": "batch/v1", "kind": "Job", "metadata": {"name": name}, "spec": body},
    ]


def filled(text: str, values: dict[str, str]) -> str:
    """Argo's placeholders replaced; an input that there is not is empty, as an optional output that was not written."""
    for name, value in values.items():
        text = text.replace(f"{{{{inputs.parameters.{name}}}}}", value)
    return text


@dataclass
class Cluster:
    """A namespace of a real cluster, by kubectl."""

    namespace: str
    log: list[str] = field(default_factory=list[str])

    def kubectl(self, *line: str, stdin: str | None = None, check: bool = True) -> str:
        done = subprocess.run(
            ["kubectl", "--namespace", self.namespace, *line], input=stdin, capture_output=True, text=True, check=False
        )
        if check and done.returncode != 0:
            raise RuntimeError(f"kubectl {' '.join(line)}: {done.stderr}")
        return done.stdout

    def apply(self, documents: list[Document]) -> None:
        self.kubectl("apply", "-f", "-", stdin=json.dumps({"apiVersion": "v1", "kind": "List", "items": documents}))

    def get(self, *what: str) -> Document:
        return json.loads(self.kubectl("get", *what, "-o", "json"))

    def pods(self, job: str) -> list[Document]:
        found = self.get("pods", "-l", f"job-name={job}")["items"]
        return sorted(found, key=lambda p: p["metadata"]["creationTimestamp"])

    def ended(self, job: str, timeout: float = 600) -> str:
        """Wait for a Job's end: Complete, or the reason that it failed for."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            for condition in self.get("job", job).get("status", {}).get("conditions", []):
                if condition["status"] == "True" and condition["type"] in ("Complete", "Failed"):
                    return "Complete" if condition["type"] == "Complete" else condition["reason"]
            time.sleep(1)
        raise TimeoutError(f"{job} did not end in {timeout} s: {self.kubectl('describe', 'pods', check=False)[-3000:]}")

    def events(self, job: str) -> list[Document]:
        """What the shim in the Job's last pod said."""
        pod = self.pods(job)[-1]["metadata"]["name"]
        lines = self.kubectl("logs", pod, check=False).splitlines()
        return [json.loads(line) for line in lines if line.startswith("{")]

    def outputs(self, job: str) -> dict[str, str]:
        """The digests that a Job's stage ended with."""
        return next((e["outputs"] for e in reversed(self.events(job)) if e["event"] == "done"), {})

    def works(self, job: str, timeout: float = 300) -> str:
        """Wait until the stage in a Job's pod tells of its progress; the pod's name."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            if self.pods(job) and any(e["event"] == "progress" for e in self.events(job)):
                return self.pods(job)[-1]["metadata"]["name"]
            time.sleep(0.5)
        raise TimeoutError(f"{job} told of no progress in {timeout} s")

    def say(self, text: str) -> None:
        """Something measured, for the log."""
        self.log.append(text)
        print(text, flush=True)  # noqa: T201 - pytest -s shows it, and -rP afterwards
