"""What worker processes cannot load is refused with its reason, before anything is written."""

from __future__ import annotations

import subprocess
import sys
import types
from dataclasses import dataclass

import pytest

from lunarsim.campaign.engines.picklable import check_picklable
from lunarsim.errors import InputError
from lunarsim.onboard.policies.library import NoDivert
from lunarsim.scenario import Scenario
from tests.worlds import TINY_FLIGHT

# As a cell of a notebook: the classes are in `__main__`, which has no file.
CELL = """
from dataclasses import dataclass
import sys
from pathlib import Path
from lunarsim.campaign import compare
from lunarsim.scenario import Scenario
from tests.worlds import TINY_FLIGHT

class Mine:
    name = "mine"
    def decide(self, observation):
        return None

scenario = Scenario.from_dict(TINY_FLIGHT)
compare(scenario, ["no-divert", Mine()], flights=2, seed=1, jobs=2, out=Path(sys.argv[1]))
"""


def test_a_policy_of_a_notebook_is_refused_with_reason_and_remedy(tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-c", CELL, str(out)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1
    assert "uses Mine, which worker processes cannot import from a notebook" in last
    assert "Move Mine into a module file, or use jobs = 1" in last
    assert not out.exists()


class Inner:
    """Something that a policy of a module may hold."""


@pytest.fixture
def main(monkeypatch):
    """Return the module `__main__` as a notebook has it, with the class `Inner`."""
    module = types.ModuleType("__main__")
    module.Inner = Inner
    monkeypatch.setitem(sys.modules, "__main__", module)
    monkeypatch.setattr(Inner, "__module__", "__main__")
    monkeypatch.setattr(sys.modules[__name__], "Inner", Inner, raising=False)
    return module


def test_objects_within_others_and_functions_are_found(main):
    for value in ([Inner()], {"a": (Inner,)}, "__main__:Inner", [{"kind": "__main__:Inner"}]):
        with pytest.raises(
            InputError, match="uses Inner, which worker processes cannot import from a notebook"
        ):
            check_picklable("policies", value)


def test_a_script_can_be_imported_by_workers(main, tmp_path):
    script = tmp_path / "script.py"
    script.write_text("")
    main.__file__ = str(script)
    check_picklable("policies", [Inner()])
    main.__file__ = "<stdin>"
    with pytest.raises(InputError, match="notebook"):
        check_picklable("policies", [Inner()])


def test_what_cannot_be_pickled_is_refused_in_one_sentence():
    with pytest.raises(
        InputError, match=r"pickle can send to worker processes \(.+\), got .+\. Use jobs = 1"
    ):
        check_picklable("policies", lambda: None)


def test_scenarios_that_name_a_class_of_a_notebook_are_refused(main, monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", "__main__")
    main.Own = dataclass(frozen=True)(type("Own", (NoDivert,), {"__module__": "__main__"}))
    scenario = Scenario.from_dict(TINY_FLIGHT | {"policy": {"kind": "__main__:Own"}})
    with pytest.raises(
        InputError, match="uses Own, which worker processes cannot import from a notebook"
    ):
        check_picklable("arm 'all'", scenario)
