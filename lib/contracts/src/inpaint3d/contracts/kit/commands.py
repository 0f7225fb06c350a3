"""How a command of ours begins and ends that is no stage's run: a page, a film, a corpus, one rank of many."""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Generator
from typing import NoReturn

from inpaint3d.contracts.errors import Inpaint3dError, InterruptedRun, from_os_error
from inpaint3d.contracts.kit.confine import confine, die_with_parent


@contextlib.contextmanager
def exit_on_error(title: str = "inpaint3d") -> Generator[None]:
    """A foreseen error of the body becomes a line on standard error and its exit code of `contracts.errors`."""
    try:
        yield
    except (Inpaint3dError, OSError) as error:
        failure = from_os_error(error) if isinstance(error, OSError) else error
        sys.stderr.write(f"{title}: {failure.kind}: {failure}\n")
        sys.exit(failure.exit_code)


def carry_out_confined(command: Callable[[], None], *, with_parent: bool) -> NoReturn:
    """Carry out what a person asked for, and exit: with 0 also where Ctrl-C ends it, which is the way out of a page.

    with_parent: end when whoever started this process ends.
    """
    signal.signal(signal.SIGTERM, _leave)
    with exit_on_error(), contextlib.suppress(KeyboardInterrupt):
        confine()
        if with_parent:
            die_with_parent()
        command()
    sys.exit(0)


def _leave(_number: int, _frame: object) -> NoReturn:
    os._exit(InterruptedRun.exit_code)
