"""Processes that servers fork are as those that were started anew, and end with whom they serve."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from inpaint3d.contracts.kit.confine import select_environment
from inpaint3d.orchestrator.runners.forks import SERVER_GONE, ForkServers

PROBE = """
import os, resource, signal, sys
print("module", __name__, sys.argv[1:], os.environ.get("PROBE"), os.environ.get("SECRET"))
print("imported", "numpy" in sys.modules, "inpaint3d.orchestrator" in sys.modules)
print("signals", signal.getsignal(signal.SIGTERM) == signal.SIG_DFL, signal.getsignal(signal.SIGINT).__name__)
print("input", sys.stdin.read() == "", "descriptors", sorted(map(int, os.listdir("/proc/self/fd")))[:3])
sys.stderr.write("to the log")
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder that started processes import modules from."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("SECRET", "token")
    return tmp_path


@pytest.fixture
def servers(place):
    servers = ForkServers()
    yield servers
    servers.close()


def run(servers, place, text, *arguments, threads=1, **environment):
    """Exit code, output and log of a module with this text."""
    name = f"probe_{len(list(place.glob('*.py')))}"
    (place / f"{name}.py").write_text(text)
    variables = {**select_environment(os.environ), "PYTHONUNBUFFERED": "1", **environment}
    with (place / "log").open("w") as log:
        process, output = servers.start([name, *arguments], variables, threads, log)
    with os.fdopen(output) as stream:
        printed = stream.read()
    return process.wait(60), printed, (place / "log").read_text()


def test_a_forked_process_is_as_one_that_was_started_anew(servers, place):
    code, printed, log = run(servers, place, PROBE, "a", "b", PROBE="asked")
    assert code == 0
    assert printed.splitlines() == [
        "module __main__ ['a', 'b'] asked None",
        "imported True False",
        "signals True default_int_handler",
        "input True descriptors [0, 1, 2]",
    ]
    assert log == "to the log"


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("import sys; sys.exit(3)", 3, ""),
        ("import sys; sys.exit('why')", 1, "why"),
        ("raise ValueError('what')", 1, "ValueError: what"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", -9, ""),
        ("import atexit, sys; atexit.register(sys.stderr.write, 'left'); sys.exit(75)", 75, "left"),
        ("from threading import Timer; import sys; Timer(0.2, lambda: sys.stderr.write('done')).start()", 0, "done"),
    ],
)  # fmt: skip
def test_how_it_ends_is_told(servers, place, text, code, said):
    ended, _, log = run(servers, place, text)
    assert ended == code
    assert said in log


def test_each_number_of_threads_has_a_server_of_its_own(servers, place):
    """What native libraries read of it, they read when they are imported, which is before the fork."""
    text = "import os; print(os.getppid())"
    one, two, again = (run(servers, place, text, threads=n)[1] for n in (1, 2, 1))
    assert one == again != two


def test_code_that_changed_since_the_server_read_it_is_read_anew(place):
    """A process that is started anew has not imported what the server has."""
    read = place / "read_before.py"
    read.write_text("")
    # As if the server had imported a module of ours from there.
    (place / "sitecustomize.py").write_text(
        f"import sys\nmodule = sys.modules['inpaint3d.read_before'] = type(sys)('a')\nmodule.__file__ = {str(read)!r}\n"
    )
    asks = "import sys; print('numpy' in sys.modules)"
    servers = ForkServers()
    assert run(servers, place, asks)[1] == "True\n"
    time.sleep(0.05)
    read.write_text("# another")
    assert run(servers, place, asks)[1] == "False\n"
    servers.close()


def test_a_server_ends_without_a_word(place, capfd):
    servers = ForkServers()
    assert run(servers, place, "print(1)")[1] == "1\n"
    servers.close()
    assert capfd.readouterr() == ("", "")


def test_a_server_that_was_killed_takes_its_stages_along_and_another_one_starts(servers, place):
    (place / "sleeps.py").write_text("from inpaint3d.contracts.kit.confine import die_with_parent\nimport time\n"
                                     "die_with_parent()\nprint('up', flush=True)\ntime.sleep(60)\n")  # fmt: skip
    with (place / "log").open("w") as log:
        process, output = servers.start(["sleeps"], select_environment(os.environ), 1, log)
    with os.fdopen(output) as stream:
        assert stream.readline() == "up\n"
        parent = int(Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[1])
        os.kill(parent, signal.SIGKILL)
        assert process.wait(30) == SERVER_GONE
        assert stream.read() == "", "the stage was told to end too"
    assert run(servers, place, "print('again')")[1] == "again\n"


def test_terminate_reaches_the_process(servers, place):
    text = "import signal, sys, time\nsignal.signal(signal.SIGTERM, lambda *_: sys.exit(143))\n"
    (place / "waits.py").write_text(text + "print('up', flush=True)\ntime.sleep(60)\n")
    with (place / "log").open("w") as log:
        process, output = servers.start(["waits"], select_environment(os.environ), 1, log)
    with os.fdopen(output) as stream:
        stream.readline()
        assert process.poll() is None
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.05)
        process.terminate()
        assert process.wait(30) == 143


def test_a_confined_process_leaves_no_core_and_gains_nothing(tmp_path):
    text = (
        "import resource; from inpaint3d.contracts.kit.confine import confine; confine()\n"
        "print(resource.getrlimit(resource.RLIMIT_CORE))\n"
        "print([l.split()[1] for l in open('/proc/self/status') if l.startswith('NoNewPrivs')])\n"
        "print(open('/proc/self/oom_score_adj').read())\n"
    )
    limits = {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_CORE, (0, resource.RLIM_INFINITY))}
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=True, cwd=tmp_path, **limits
    )
    assert done.stdout.split("\n")[:3] == ["(0, 0)", "['1']", "500"]


def test_only_what_a_stage_needs_is_passed_on():
    given = {
        "PATH": "/bin",
        "OMP_NUM_THREADS": "2",
        "AWS_REGION": "a",
        "GITHUB_TOKEN": "x",
        "LC_ALL": "C",
        "DB_PASSWORD": "x",
    }
    assert set(select_environment(given)) == {"PATH", "OMP_NUM_THREADS", "AWS_REGION", "LC_ALL"}
