import json
from pathlib import Path

import pytest

from tests.faults.results import conclude


def test_each_program_keeps_the_figures_of_the_others(tmp_path: Path) -> None:
    out = tmp_path / "reliability.json"
    for section, faults, code in (("one", [], 0), ("two", ["a result was lost"], 1), ("one", [], 0)):
        with pytest.raises(SystemExit) as left:
            conclude(section, {"times": 3}, faults, out)
        assert left.value.code == code
    kept = json.loads(out.read_text())
    assert kept == {
        "one": {"times": 3, "failed": 0, "faults": []},
        "two": {"times": 3, "failed": 1, "faults": ["a result was lost"]},
    }
