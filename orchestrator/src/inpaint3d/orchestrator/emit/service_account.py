"""Who the pods are to the cluster: an account whose pods may tell Argo how they ended, and nothing else."""

from typing import Any

from inpaint3d.contracts.models.cluster import ClusterSpec

Document = dict[str, Any]
RBAC = "rbac.authorization.k8s.io"
REPORTS = {"apiGroups": ["argoproj.io"], "resources": ["workflowtaskresults"], "verbs": ["create", "patch"]}
"""Without it every pod of Argo 3.4 and later ends in an error, whatever its container did."""


def write_service_account(cluster: ClusterSpec) -> list[Document]:
    """ServiceAccount, Role and RoleBinding of the name in `cluster.yaml`."""
    name = cluster.spec.serviceAccountName
    metadata: Document = {"name": name, "namespace": cluster.spec.namespace}
    return [
        {"apiVersion": "v1", "kind": "ServiceAccount", "metadata": metadata},
        {"apiVersion": f"{RBAC}/v1", "kind": "Role", "metadata": metadata, "rules": [REPORTS]},
        {
            "apiVersion": f"{RBAC}/v1",
            "kind": "RoleBinding",
            "metadata": metadata,
            "roleRef": {"apiGroup": RBAC, "kind": "Role", "name": name},
            "subjects": [{"kind": "ServiceAccount", "name": name, "namespace": cluster.spec.namespace}],
        },
    ]
