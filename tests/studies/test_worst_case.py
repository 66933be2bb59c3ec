"""A search for the worst case as a study: resumption, processes, report and scenarios."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.search import ContinuousRange, SearchSpace
from lunarsim.studies.command import study_command
from lunarsim.studies.worst_case import WorstCaseProblem
from tests.studies.worst_case_toy import SPACE, build, study

TOY = Path(__file__).with_name("worst_case_toy.py")
ASKED = ["--evaluations", 40, "--findings", 1, "--seed", 3]


def invoke(*arguments):
    return CliRunner().invoke(study_command(study), [str(a) for a in arguments])


def results(folder):
    return json.loads((folder / "results.json").read_text())


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    out = tmp_path_factory.mktemp("worst_case") / "out"
    done = invoke(*ASKED, "--out", out)
    assert done.exit_code == 0, done.output
    return out, done.output


def test_an_interrupted_search_continues_with_equal_results(tmp_path, complete):
    traces, out = tmp_path / "traces", tmp_path / "out"
    traces.mkdir()
    (traces / "stop").touch()
    asked = [*ASKED, "--out", out, "--traces", traces]
    done = invoke(*asked)
    # 59 evaluations and the file that stops the next: in the middle of a batch.
    assert done.exit_code == 0 and "Interrupted after 59 of 80 cases" in done.output
    assert not results(out)["complete"] and len(results(out)["rows"]) == 59
    for file in traces.iterdir():
        file.unlink()
    with (out / "journal.jsonl").open("a") as file:
        file.write('[59, {"score"')
    assert invoke(*asked).exit_code == 0
    rows = results(complete[0])["rows"]
    assert len(list(traces.iterdir())) == len(rows) - 59
    assert results(out)["complete"] and results(out)["rows"] == rows


def test_two_processes_give_the_same_results(tmp_path, complete):
    command = [sys.executable, str(TOY), *map(str, ASKED), "--jobs", "2", "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    assert results(tmp_path)["rows"] == results(complete[0])["rows"]


def test_the_report_names_the_keys_and_writes_scenarios(complete):
    out, text = complete
    assert (out / "worst_case.png").stat().st_size > 10_000
    lines = [line for line in text.splitlines() if "finding_1" in line]
    assert len(lines) == 3
    assert "2 of 8" in lines[0]
    assert "rocks.cover" in lines[1] and "rocks.shape" in lines[2]
    scenario = Scenario.load(out / "finding_1.toml")
    shrunk = next(r["values"] for r in results(out)["rows"] if r["phase"] == "shrunk")
    assert scenario.name == "finding_1" and scenario.rocks.shape == "cube"
    assert scenario.rocks.cover == shrunk["rocks.cover"]


def test_an_unknown_key_and_an_inadmissible_range_are_refused():
    for key, high, message in (
        ("rocks.cove", 0.1, "rocks.cove"), ("rocks.cover", 0.3, "ranges.rocks.cover: must be"),
    ):  # fmt: skip
        space = SearchSpace({**SPACE.ranges, key: ContinuousRange(0.01, high, 0.05)})
        problem = WorstCaseProblem(space, build, 0.95, "score")
        with pytest.raises(InputError) as error:
            problem.explore(lambda _: pytest.fail("a case was measured"), 40, 1, {
                "findings": 1, "draws": 10,
            })  # fmt: skip
        assert message in str(error.value)
