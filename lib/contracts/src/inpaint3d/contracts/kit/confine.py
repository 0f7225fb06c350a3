"""What a stage's process may do: less than who started it, and not for longer."""

import contextlib
import ctypes
import os
import resource
import signal
import sys
from collections.abc import Mapping
from pathlib import Path

PASSED_ON = frozenset(
    (
        "PATH", "HOME", "USER", "LANG", "LANGUAGE", "TZ", "TMPDIR", "VIRTUAL_ENV", "LD_LIBRARY_PATH",
        "SSL_CERT_FILE", "SSL_CERT_DIR",
        "HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY", "http_proxy", "https_proxy", "no_proxy",
    )
)  # fmt: skip
FAMILIES = (
    "INPAINT3D_", "LC_", "PYTHON", "PYDANTIC_", "OMP_", "OPENBLAS_", "MKL_", "GOMP_", "KMP_", "CUDA_", "NVIDIA_",
    "TORCH", "TRITON_", "NCCL_", "HF_", "XDG_", "AWS_",
)  # fmt: skip
"""AWS_: a store may be a bucket."""
PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS = 1, 38
EXPENDABLE = "500"
"""Where memory runs out, the kernel is to take a stage, which goes on from its checkpoint, not who records its end."""


def select_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """The variables that a stage needs: not the passwords and tokens of whatever else runs here."""
    return {n: v for n, v in environment.items() if n in PASSED_ON or n.startswith(FAMILIES)}


def confine() -> None:
    """No core dumps (they hold somebody's photos), no new privileges, and the first to go where memory runs out."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
        with contextlib.suppress(OSError):  # no /proc, or another rule
            Path("/proc/self/oom_score_adj").write_text(EXPENDABLE)


def die_with_parent() -> None:
    """Ask Linux for SIGTERM when the process that started this one dies, so that a kill leaves no orphan at work."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() == 1:  # it died before it could be asked
            os.kill(os.getpid(), signal.SIGTERM)
