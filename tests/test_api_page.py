"""docs/reference/api.md lists the public names, each with a directive and an example that runs."""

from __future__ import annotations

import ast
import doctest
import re
import subprocess
import sys
import types
from typing import NamedTuple

import pytest

import lunarsim
import lunarsim.api
from lunarsim.parts.module_permission import ALLOW_MODULES_VARIABLE
from tests.worlds import ROOT

PAGE = ROOT / "docs" / "reference" / "api.md"
PUBLIC_MODULES = {"lunarsim": lunarsim, "lunarsim.api": lunarsim.api}
PUBLIC_NAMES = {*lunarsim.__all__, *lunarsim.api.__all__}
MAX_IMPORT_TIME_S = 0.1


class Page(NamedTuple):
    """What the test reads of a page: its examples, and the names that its directives document."""

    examples: list[doctest.Example]
    documented: list[str]


def read_page(text: str) -> Page:
    """Return examples, with their lines on the page, and documented names."""
    examples = []
    for block in re.finditer(r"^```pycon\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        first_line = text[: block.start(1)].count("\n")
        for example in doctest.DocTestParser().get_examples(block.group(1), str(PAGE)):
            example.lineno += first_line
            examples.append(example)
    directives = re.findall(
        r"^\.\. auto(?:class|function|exception):: ([\w.]+)", text, re.MULTILINE
    )
    return Page(examples, directives)


def names_in_code(source: str) -> set[str]:
    """Return the public names that Python code uses; an import alone does not count."""
    tree = ast.parse(source)
    imported = {
        alias.asname or alias.name: alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in PUBLIC_MODULES
        for alias in node.names
    }
    used = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            used.add(imported.get(node.id, ""))
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) in PUBLIC_MODULES:
            used.add(node.attr)
    return used & PUBLIC_NAMES


@pytest.fixture(scope="module")
def page() -> Page:
    return read_page(PAGE.read_text(encoding="utf-8"))


def test_examples_give_what_they_say(page, tmp_path, monkeypatch):
    """In one session and in module `__main__`, as at a prompt, which parts are named by."""
    session = types.ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", session)
    monkeypatch.setenv(ALLOW_MODULES_VARIABLE, "")
    monkeypatch.chdir(tmp_path)
    test = doctest.DocTest(page.examples, {}, "docs/reference/api.md", str(PAGE), 0, None)
    test.globs = vars(session)  # not a copy: classes find their module's names
    report: list[str] = []
    result = doctest.DocTestRunner().run(test, out=report.append, clear_globs=False)
    assert not result.failed, "".join(report)
    assert result.attempted > 100


def test_every_public_name_is_used_in_an_example(page):
    missing = PUBLIC_NAMES - names_in_code("".join(example.source for example in page.examples))
    assert not missing, f"docs/reference/api.md: no example uses {sorted(missing)}"


def test_the_page_documents_the_public_names_and_no_others(page):
    results = {
        "lunarsim.vehicle.touchdown.LandingOutcome", "lunarsim.vehicle.touchdown.Touchdown",
        "lunarsim.simulation.image_record.ImageRecord",
    }  # fmt: skip
    assert results <= set(page.documented)  # attributes of a flight, which users do not import
    names = [path.rpartition(".") for path in page.documented if path not in results]
    for module, _, name in names:
        assert name in PUBLIC_MODULES[module].__all__
    assert sorted(name for _, _, name in names) == sorted(PUBLIC_NAMES)


def test_a_name_without_an_example_is_found():
    text = (
        "```{eval-rst}\n.. autofunction:: lunarsim.fly\n```\n"
        "```pycon\n>>> from lunarsim.api import hidden, Sensor\n>>> lunarsim.render, Sensor\n```\n"
    )
    examples, documented = read_page(text)
    assert documented == ["lunarsim.fly"]
    assert [example.lineno for example in examples] == [4, 5]
    used = names_in_code("".join(example.source for example in examples))
    assert used == {"render", "Sensor"}


def test_import_takes_the_time_that_the_page_states():
    code = (
        "import sys, time; start = time.process_time(); import lunarsim, lunarsim.api;"
        "print(time.process_time() - start, *{'moderngl', 'numba'}.intersection(sys.modules))"
    )
    command = [sys.executable, "-c", code]
    runs = [
        subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
        for _ in range(3)
    ]
    assert {len(run) for run in runs} == {1}, "loads OpenGL or Numba"
    assert min(float(run[0]) for run in runs) < MAX_IMPORT_TIME_S
    assert f"{MAX_IMPORT_TIME_S:g} s of processor time" in PAGE.read_text(encoding="utf-8")
