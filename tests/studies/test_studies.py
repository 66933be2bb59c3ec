"""Studies: cases, journal, results file, report and command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.studies import Metric, Report, Study, pack_array, run_study, unpack_array
from lunarsim.studies.command import report_folder, study_command, study_name
from lunarsim.studies.library import load_study, study_files, summary
from lunarsim.studies.report import print_metrics
from lunarsim.studies.results import plain
from tests.studies.toy import study

TOY = Path(__file__).with_name("toy.py")


def invoke(*arguments):
    return CliRunner().invoke(study_command(study), [str(a) for a in arguments])


def results(folder):
    return json.loads((folder / "results.json").read_text())


def test_all_combinations_are_measured_on_the_same_numbers():
    rows = run_study(study, count=3, seed=5)
    assert len(rows) == 2 * 2 * 3 * 2
    assert [(r["size"], r["shift"], r["number"], r["half"]) for r in rows[:3]] == [
        (10, 0.0, 0, 0), (10, 0.0, 0, 1), (10, 0.0, 1, 0),
    ]  # fmt: skip
    means = {(r["size"], r["shift"], r["number"]): r["mean"] for r in rows}
    for n in range(3):
        assert means[1000, 1.0, n] == pytest.approx(means[1000, 0.0, n] + 1.0)
        expected = np.random.default_rng([5, n]).standard_normal(10).mean()
        assert means[10, 0.0, n] == pytest.approx(expected)


def test_processes_do_not_change_the_results(tmp_path):
    asked = ["--draws", "3", "--seed", "2"]
    command = [sys.executable, str(TOY), *asked, "--jobs", "2", "--out", str(tmp_path / "2")]
    subprocess.run(command, check=True)
    assert invoke(*asked, "--out", tmp_path / "1").exit_code == 0
    two, one = (results(tmp_path / jobs) for jobs in ("1", "2"))
    assert one["rows"] == two["rows"] and one["complete"]
    assert one["options"] == {
        "draws": 3, "seed": 2, "levels": {"size": [10, 1000], "shift": [0.0, 1.0]}, "traces": "",
    }  # fmt: skip
    assert one["study"] == "toy" and study_name(load_study("landers/slosh")) == "landers/slosh"
    assert one["columns"] == {"mean": "mean (m)", "positive": "positive"}
    assert "--draws 3" in one["command"] and one["machine"]["numpy"] == np.__version__


def test_an_interrupted_study_continues(tmp_path):
    traces, out = tmp_path / "traces", tmp_path / "out"
    traces.mkdir()
    (traces / "stop").touch()
    asked = ["--draws", 2, "--out", out, "--traces", traces]
    done = invoke(*asked)
    assert done.exit_code == 0 and "Interrupted after 2 of 8 cases" in done.output
    assert not results(out)["complete"] and len(results(out)["rows"]) == 4
    for file in traces.iterdir():
        file.unlink()
    # A killed process can leave half a line.
    with (out / "journal.jsonl").open("a") as file:
        file.write('[2, [{"mean"')
    assert invoke(*asked).exit_code == 0
    assert len(list(traces.iterdir())) == 6
    complete = results(out)
    assert complete["complete"] and complete["rows"] == run_study(study, count=2)
    for file in traces.iterdir():
        file.unlink()
    assert invoke(*asked).exit_code == 0
    assert list(traces.iterdir()) == []


@pytest.mark.parametrize("changed", [["--seed", 2], ["--draws", 3], ["--size", 10]])
def test_a_folder_of_other_results_is_refused(tmp_path, changed):
    assert invoke("--draws", 1, "--out", tmp_path / "out").exit_code == 0
    before = (tmp_path / "out" / "results.json").read_bytes()
    done = invoke("--draws", 1, "--out", tmp_path / "out", *changed)
    assert done.exit_code == 2
    assert "holds results of another study" in done.output
    assert (tmp_path / "out" / "results.json").read_bytes() == before


def test_a_changed_module_beside_the_script_or_another_machine_is_refused(tmp_path):
    helper, script = tmp_path / "helper_of_study.py", tmp_path / "studied.py"
    helper.write_text("VALUE = 1.0\n")
    script.write_text(
        "'''Toy.'''\n\n"
        "from helper_of_study import VALUE\n"
        "from lunarsim.studies import Metric, Study, run_script\n\n\n"
        "def measure(case):\n    return {'value': VALUE}\n\n\n"
        "study = Study(measure, repeats='draws', count=1, metrics={'value': Metric('value')})\n"
        "if __name__ == '__main__':\n    run_script(study)\n"
    )
    command = [sys.executable, str(script), "--out", str(tmp_path / "out")]
    subprocess.run(command, check=True)
    helper.write_text("VALUE = 2.0\n")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "another study, version, machine or options" in done.stderr
    assert results(tmp_path / "out")["rows"][0]["value"] == 1.0
    helper.write_text("VALUE = 1.0\n")
    journal = tmp_path / "out" / "journal.jsonl"
    journal.write_text(journal.read_text().replace(np.__version__, "1.0.0"))
    assert subprocess.run(command, capture_output=True, check=False).returncode == 2


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "thesis.tex").touch()
    done = invoke("--out", tmp_path)
    assert done.exit_code == 2 and "must be a new or empty folder" in done.output
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_the_report_has_metrics_and_paired_differences(tmp_path):
    out = tmp_path / "out"
    done = invoke("--draws", 5, "--size", 1000, "--size", 10, "--out", out)
    assert done.exit_code == 0, done.output
    rows = [r for r in results(out)["rows"] if (r["size"], r["shift"]) == (1000, 1.0)]
    means = [r["mean"] for r in rows]
    assert f"{np.median(means):.2f} / {max(means):.2f}" in done.output
    assert "1.000 [" in done.output  # all positive
    assert "1000 minus 10" in done.output
    assert f"{out / 'results.json'}" in done.output


def test_a_report_is_printed_again_from_its_folder(tmp_path, capsys):
    out = tmp_path / "out"
    printed = invoke("--draws", 2, "--out", out).output
    capsys.readouterr()
    report_folder(study, out)
    again = capsys.readouterr().out
    assert again.strip() and again.strip() in printed
    with pytest.raises(InputError, match=r"results\.json of the study"):
        report_folder(study, tmp_path)
    kept = results(out)
    (out / "results.json").write_text(json.dumps({**kept, "study": "landers/slosh"}))
    with pytest.raises(InputError, match="it holds the study landers/slosh"):
        report_folder(study, out)
    (out / "results.json").write_text(json.dumps({**kept, "options": {}}))
    with pytest.raises(InputError, match=r"'seed' is missing"):
        report_folder(study, out)
    (out / "results.json").write_text("[1")
    with pytest.raises(InputError, match=r"results\.json of the study"):
        report_folder(study, out)


def test_statistics_of_a_metric():
    values = [1.0, 2.0, float("nan"), 6.0]
    assert Metric("x", "median", 1).text(values) == "2.0"
    assert Metric("x", "max", 0).text(values) == "6"
    assert Metric("x", "sum", 0).text(values) == "9"
    assert Metric("x", "rms", 2).text([3.0, 4.0, float("nan")]) == "3.54"
    assert Metric("x", "median-p95", 1).text(values) == "2.0 / 5.6"
    assert Metric("x", "mean", 1).text([float("nan")]) == "-"
    assert Metric("x", "count").text([True, False, True]) == "2"
    share = Metric("x", "share").text([True] * 18 + [False] * 2 + [float("nan"), None])
    assert share == "0.900 [0.699, 0.972]"
    with pytest.raises(ValueError, match="statistic"):
        Metric("x", "average")
    rng = np.random.default_rng(1)
    assert Metric("x", "mean", 2).difference([1.0, 2.0], [1.5, 2.5], rng) == "+0.50 [+0.50, +0.50]"
    share = Metric("x", "share").difference([True] * 10, [False] * 10, rng)
    assert share.startswith("-1.000 [-1.000")


def test_groups_and_columns_of_a_report():
    rows = [{"a": 1, "x": 2.0}, {"a": 2}, {"a": 1, "x": None}]
    report = Report(rows, ["a"], "draws", {}, False, {}, 1, None)
    assert report.groups("a") == {(1,): [rows[0], rows[2]], (2,): [rows[1]]}
    assert np.array_equal(report.column("x"), [2.0, np.nan, np.nan], equal_nan=True)


def test_all_rows_of_a_case_are_paired():
    rows = [
        {"way": way, "number": n, "x": 10.0 * n + row + (way == "b") * (1.0 + row)}
        for way in "ab" for n in range(3) for row in range(2)
    ]  # fmt: skip
    console = Console(record=True, width=100)
    report = Report(rows, ["way"], "draws", {"x": Metric("x (m)")}, True, {}, 1, console)
    print_metrics(report)
    assert "+1.500 [" in console.export_text()  # first rows differ by 1, second ones by 2


def test_an_option_without_a_default_has_the_value_of_the_command_line():
    options = (click.Option(["--note"]), click.Option(["--level"], type=float, multiple=True))
    optional = Study(lambda case: {"note": case["note"], "level": case["level"]}, "draws", 1,
                     options=options)  # fmt: skip
    assert run_study(optional) == [{"number": 0, "note": None, "level": []}]


@pytest.mark.parametrize("line", ["{}", "[1]", "7", '"x"'])
def test_a_damaged_line_of_the_journal_is_measured_again(tmp_path, line):
    out = tmp_path / "out"
    assert invoke("--draws", 1, "--out", out).exit_code == 0
    before = results(out)["rows"]
    with (out / "journal.jsonl").open("a") as file:
        file.write(line + "\n")
    assert invoke("--draws", 1, "--out", out).exit_code == 0
    assert results(out)["rows"] == before


def test_rows_that_cannot_be_kept_are_refused(tmp_path):
    with pytest.raises(TypeError, match="rows must hold numbers, texts and lists, got set"):
        plain([{"a": {1}}])


def test_studies_are_listed_and_run_by_name():
    listed = CliRunner().invoke(main, ["study", "list"])
    assert listed.exit_code == 0
    assert "landers/slosh" in listed.output
    files = study_files()
    assert all(summary(path).endswith(".") for path in files.values())
    helped = CliRunner().invoke(main, ["study", "run", "landers/slosh", "--help"])
    assert helped.exit_code == 0 and "--control" in helped.output
    wrong = CliRunner().invoke(main, ["study", "run", "landers/slush"])
    assert wrong.exit_code == 2 and "Did you mean 'landers/slosh'? List" in wrong.output
    with pytest.raises(InputError, match="Did you mean"):
        load_study("landers/slush")


@pytest.mark.parametrize("array", [np.arange(6.0).reshape(2, 3) / 7.0, np.array([True, False])])
def test_packed_arrays_are_exact(array):
    text = pack_array(array)
    assert plain(text) == text
    again = unpack_array(text)
    assert again.dtype == array.dtype
    np.testing.assert_array_equal(again, array)


def test_studies_of_two_folders_use_their_own_modules():
    """Both folders have a module `figures`."""
    for name in ("quadtree/hazard_field", "gaussian_dem/tables", "quadtree/hazard_field"):
        assert study_name(load_study(name)) == name
