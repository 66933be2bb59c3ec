"""Mutation testing on a toy package without compilation."""

import importlib
import json
import threading
import time

import pytest
from click.testing import CliRunner

from tests.conftest import ROOT

TOY = """from lunarsim._jit import kernel

LIMIT = 2.0


def helper(a, b):
    return a - b


@kernel(inline=True)
def clipped(a, b, out):
    '''Return 1 + 1.'''
    room = np.empty(a + 1)
    if a < b and -b <= out[0]:
        out[1] = a - (b + 1)
    return min(max(a, 0.0), foo(a, b)) * LIMIT
"""


@pytest.fixture(autouse=True)
def scripts_on_the_path(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # faster start of the toy trials


@pytest.fixture
def faults():
    return importlib.import_module("mutant_parts.faults")


def toy_package(root, test):
    """Write a package of two kernel files, one calling the other, and its test."""
    (root / "lunarsim").mkdir(parents=True)
    (root / "lunarsim" / "__init__.py").write_text("")
    (root / "lunarsim" / "_jit.py").write_text(
        "def kernel(**how):\n    return lambda function: function\n"
    )
    (root / "lunarsim" / "a_kernels.py").write_text(
        "from lunarsim._jit import kernel\n\n\n@kernel()\ndef room(a, b):\n    return a - b\n"
    )
    (root / "lunarsim" / "b_kernels.py").write_text(
        "from lunarsim.a_kernels import room\n\n\ndef half(a, b):\n    return room(a, b) / 2\n"
    )
    (root / "tests").mkdir()
    (root / "tests" / "test_room.py").write_text(test)
    (root / "pyproject.toml").write_text("")


CATCHES = "from lunarsim.a_kernels import room\n\n\ndef test_room():\n    assert room(5, 3) == 2\n"
LETS_PASS = CATCHES.replace("room(5, 3) == 2", "room(0, 0) == 0")


def test_every_kind_of_fault_is_generated_at_its_place(faults):
    found = {f.name: f.line_after(TOY) for f in faults.faults_of("toy.py", TOY)}
    assert found == {
        "toy.py:3:8:constant": "LIMIT = 3.0",
        "toy.py:14:9:boundary": "if a <= b and -b <= out[0]:",
        "toy.py:14:9:opposite": "if a >= b and -b <= out[0]:",
        "toy.py:14:7:opposite": "if not (a < b and -b <= out[0]):",
        "toy.py:14:13:and-or": "if a < b or -b <= out[0]:",
        "toy.py:14:17:sign": "if a < b and (b) <= out[0]:",
        "toy.py:14:20:boundary": "if a < b and -b < out[0]:",
        "toy.py:14:20:opposite": "if a < b and -b > out[0]:",
        "toy.py:14:27:index": "if a < b and -b <= out[1]:",
        "toy.py:15:8:drop-statement": "pass",
        "toy.py:15:12:index": "out[2] = a - (b + 1)",
        "toy.py:15:19:drop-term": "out[1] = a",
        "toy.py:15:19:plus-minus": "out[1] = a + (b + 1)",
        "toy.py:15:24:drop-term": "out[1] = a - (b )",
        "toy.py:15:24:plus-minus": "out[1] = a - (b - 1)",
        "toy.py:15:26:constant": "out[1] = a - (b + 2)",
        "toy.py:16:11:min-max": "return max(max(a, 0.0), foo(a, b)) * LIMIT",
        "toy.py:16:15:min-max": "return min(min(a, 0.0), foo(a, b)) * LIMIT",
        "toy.py:16:22:constant": "return min(max(a, 1.0), foo(a, b)) * LIMIT",
        "toy.py:16:32:swap-arguments": "return min(max(a, 0.0), foo(b, a)) * LIMIT",
        "toy.py:16:39:drop-term": "return min(max(a, 0.0), foo(a, b))",
        "toy.py:16:39:times-over": "return min(max(a, 0.0), foo(a, b)) / LIMIT",
    }


def test_every_fault_of_the_package_has_a_unique_name_and_is_valid_python(faults):
    mutants = importlib.import_module("mutants")
    files = mutants.kernel_files()
    assert len(files) >= 28
    for path, text in files.items():
        found = faults.faults_of(path, text)
        assert len({f.name for f in found}) == len(found) > 0
        for fault in found[::20]:
            compile(fault.apply(text), path, "exec")
        for test in mutants.tests_of(path):
            assert (ROOT / test).exists()


def test_sample_covers_every_kind_and_ignores_changes_elsewhere(faults):
    path, text = "lunarsim/x.py", (ROOT / "lunarsim/rocks/_kernels.py").read_text()
    found = faults.faults_of(path, text)
    drawn = faults.sample_faults(found, 15, seed=1)
    assert len(set(drawn)) == 15
    assert {f.operator for f in drawn} == {f.operator for f in found}
    lower = text.replace("@kernel", "# One more line.\n@kernel", 1)
    again = faults.sample_faults(faults.faults_of(path, lower), 15, seed=1)
    assert [(f.code, f.column, f.line - 1) for f in again] == [
        (f.code, f.column, f.line) for f in drawn
    ]
    assert faults.sample_faults(found, 15, seed=2) != drawn


def test_faults_per_file_are_proportional_to_lines_with_a_minimum_of_two():
    mutants = importlib.import_module("mutants")
    assert mutants.faults_per_file({"a": 300, "b": 99, "c": 1}, 40) == {"a": 30, "b": 10, "c": 2}


def test_direct_and_indirect_callers_are_found(tmp_path):
    trial = importlib.import_module("mutant_parts.trial")
    for name, text in (("a", ""), ("b", "from p.a import x"), ("c", "from p.b import y")):
        (tmp_path / "p").mkdir(exist_ok=True)
        (tmp_path / "p" / f"{name}.py").write_text(text)
    users = trial.importers(sorted(tmp_path.rglob("*.py")), tmp_path)
    assert users["p/a.py"] == {"p/a.py", "p/b.py", "p/c.py"}
    assert users["p/c.py"] == {"p/c.py"}


@pytest.mark.parametrize(("test", "verdict"), [(CATCHES, "caught"), (LETS_PASS, "survived")])
def test_fault_is_tried_in_a_copy_and_its_result_stored(tmp_path, faults, test, verdict):
    run = importlib.import_module("mutant_parts.run")
    root = tmp_path / "tree"
    toy_package(root, test)
    path = "lunarsim/a_kernels.py"
    text = (root / path).read_text()
    fault = next(f for f in faults.faults_of(path, text) if f.operator == "plus-minus")
    tests = {path: ["tests/test_room.py"]}
    kept = tmp_path / "kept.jsonl"
    told = []
    run.MutationRun(root, kept, tests).run([fault], jobs=1, limit=60.0, report=told.append)
    assert [r.verdict for r in told] == [verdict]
    assert (root / path).read_text() == text
    assert not list((root / "lunarsim").glob("__pycache__"))
    assert [json.loads(line)["fault"] for line in kept.read_text().splitlines()] == [
        path,  # without a fault
        fault.name,
    ]
    # The next run uses the stored result until the source or a survivor's test changes.
    assert run.MutationRun(root, kept, tests).known(fault) == told[0]
    (root / "tests" / "test_room.py").write_text(test + "\n")
    again = run.MutationRun(root, kept, tests).known(fault)
    assert again == (told[0] if verdict == "caught" else None)
    (root / path).write_text(text + "\n")
    assert run.MutationRun(root, kept, tests).known(fault) is None


def test_stopped_trial_has_no_result_and_restores_the_file(tmp_path, faults):
    trial = importlib.import_module("mutant_parts.trial")
    sign = tmp_path / "under way"
    toy_package(
        tmp_path / "tree",
        "import time\nfrom pathlib import Path\n\n\ndef test_long():\n"
        f"    Path({str(sign)!r}).touch()\n    time.sleep(600)\n",
    )
    path = "lunarsim/a_kernels.py"
    text = (tmp_path / "tree" / path).read_text()
    space = trial.MutantWorkspace(tmp_path / "tree", tmp_path / "copy")

    def stop():
        while not sign.exists():
            time.sleep(0.05)
        space.stop()

    stopper = threading.Thread(target=stop)
    stopper.start()
    fault = faults.faults_of(path, text)[0]
    for _ in range(2):
        with pytest.raises(trial.TrialStopped):
            space.trial(fault, ["tests/test_room.py"], 300.0)
    stopper.join()
    assert (tmp_path / "copy" / path).read_text() == text


def test_tests_that_fail_without_a_fault_end_the_run(tmp_path, faults):
    trial = importlib.import_module("mutant_parts.trial")
    toy_package(tmp_path / "tree", CATCHES.replace("== 2", "== 3"))
    space = trial.MutantWorkspace(tmp_path / "tree", tmp_path / "copy")
    with pytest.raises(trial.BrokenTestsError, match=r"tests of \S+a_kernels.py: must pass"):
        space.run_without_fault("lunarsim/a_kernels.py", ["tests/test_room.py"])


def test_kernels_compiled_without_the_fault_are_restored(tmp_path, faults):
    trial = importlib.import_module("mutant_parts.trial")
    toy_package(
        tmp_path / "tree",
        "from pathlib import Path\n\nimport lunarsim\n\n\ndef test_cache():\n"
        "    cache = Path(lunarsim.__file__).parent / '__pycache__'\n"
        "    assert {p.name for p in cache.glob('*.nbi')} == {'c_kernels.f.nbi'}\n"
        "    (cache / 'a_kernels.f.nbi').write_text('faulty')\n",
    )
    cache = tmp_path / "tree" / "lunarsim" / "__pycache__"
    cache.mkdir()
    for name in "abc":
        (cache / f"{name}_kernels.f.nbi").write_text("good")
    space = trial.MutantWorkspace(tmp_path / "tree", tmp_path / "copy")
    path = "lunarsim/a_kernels.py"
    fault = faults.faults_of(path, (tmp_path / "tree" / path).read_text())[0]
    # The kernels of b contain those of a; c calls neither.
    assert space.trial(fault, ["tests/test_room.py"], 60.0) == ("survived", "")
    copied = tmp_path / "copy" / "lunarsim" / "__pycache__"
    assert {p.name: p.read_text() for p in copied.glob("*.nbi")} == {
        f"{name}_kernels.f.nbi": "good" for name in "abc"
    }


def test_equivalents_are_matched_by_code_and_stale_ones_reported(tmp_path, faults):
    equivalent = importlib.import_module("mutant_parts.equivalent")
    mutants = importlib.import_module("mutants")
    path = tmp_path / "list.toml"
    entry = {"code": "if a < b and -b <= out[0]:", "reason": "a is never b"}
    path.write_text(
        "".join(
            f"[[equivalent]]\nfault = '{name}'\ncode = '{code}'\nreason = 'as it is'\n"
            for name, code in (
                ("toy.py:99:9:boundary", entry["code"]),
                ("toy.py:14:9:boundary", "if a < c:"),
            )
        )
    )
    known = equivalent.load_equivalents(path)
    tried, listed, stale = mutants.select_faults({"toy.py": TOY}, "", 100, 1, known)
    assert [(f.name, reason) for f, reason in listed] == [("toy.py:14:9:boundary", "as it is")]
    assert stale == [known[1]]
    assert len(tried) == len(faults.faults_of("toy.py", TOY)) - 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[[equivalent]]\nfault = 'a.py:1:2:sign'\ncode = 'x'",
            "entry 1: must have the keys",
        ),
        ("[[equivalent]]\nfault = 'a.py:sign'\ncode = 'x'\nreason = 'y'", "got 'a.py:sign'"),
        ("[[equivalent", "list.toml"),
    ],
)
def test_invalid_list_is_rejected(tmp_path, text, message):
    equivalent = importlib.import_module("mutant_parts.equivalent")
    (tmp_path / "list.toml").write_text(text)
    with pytest.raises(equivalent.BrokenListError, match=message):
        equivalent.load_equivalents(tmp_path / "list.toml")


def test_listed_faults_exist():
    equivalent = importlib.import_module("mutant_parts.equivalent")
    mutants = importlib.import_module("mutants")
    known = equivalent.load_equivalents(mutants.EQUIVALENT)
    assert not mutants.select_faults(mutants.kernel_files(), "", 1, 1, known)[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--count", "0"], "--count"),
        (["--only", "no such file"], "must be part of a fault name, got 'no such file'"),
        (["--results", "RESULTS"], "line 1: must be the JSON result"),
    ],
)
def test_invalid_input_exits_with_two(tmp_path, arguments, message):
    kept = tmp_path / "kept.jsonl"
    kept.write_text(json.dumps({"fault": "a"}) + "\n")
    arguments = [str(kept) if a == "RESULTS" else a for a in arguments]
    mutants = importlib.import_module("mutants")
    done = CliRunner().invoke(mutants.main, ["--list", *arguments])
    assert done.exit_code == 2
    assert message in done.output
