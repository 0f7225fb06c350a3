"""Figures as they come: one file, whole after each of them, so that what stops a run takes none away."""

import json
import math
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SHOWN = 200
"""Characters of a figure that are said; the file has all."""


@dataclass
class Results:
    """The figures of a part in a file that holds all parts'. until: the part's end by `time.monotonic`, seconds."""

    path: Path
    part: str
    until: float
    started: float = field(default_factory=time.monotonic)

    @property
    def left_s(self) -> float:
        return self.until - time.monotonic()

    def put(self, name: str, value: Any) -> None:
        """Write a figure, or several, under a name."""
        every = json.loads(self.path.read_text()) if self.path.is_file() else {}
        every.setdefault(self.part, {})[name] = value
        staged = self.path.with_suffix(".new")
        staged.write_text(json.dumps(every, indent=1) + "\n")
        staged.replace(self.path)
        print(f"{time.monotonic() - self.started:7.1f} s  {self.part}: {name}: {json.dumps(value)[:SHOWN]}", flush=True)

    def attempt(self, name: str, work: Callable[[], Any], needs_s: float = -math.inf) -> None:
        """Put what some work returns; or why it failed, or that too little time was left for it. Never raises."""
        if self.left_s < needs_s:
            self.put(name, {"skipped": f"{self.left_s:.0f} s were left, it takes {needs_s:.0f}"})
            return
        start = time.monotonic()
        try:
            found = work()
        except Exception as error:  # whatever it is, the other figures are wanted too
            traceback.print_exc()
            found = {"failed": f"{type(error).__name__}: {error}"[:600]}
        seconds = round(time.monotonic() - start, 2)
        self.put(name, found | {"seconds": seconds} if isinstance(found, dict) else found)
