"""Options of click commands in scripts reach the parameters of their functions."""

from __future__ import annotations

import ast

import pytest

from tests.conftest import ROOT


def _commands(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            calls = [d for d in node.decorator_list if isinstance(d, ast.Call)]
            if any(ast.unparse(d.func).endswith(("click.command", ".command")) for d in calls):
                yield node, calls


def _parameter(call):
    """Return the parameter name of an option or argument, by click's rules."""
    names = [a.value for a in call.args if isinstance(a, ast.Constant)]
    given = [name for name in names if not name.startswith("-")]
    longest = max(names, key=lambda name: len(name) - len(name.lstrip("-")))
    return given[0] if given else longest.split("/")[0].lstrip("-").replace("-", "_").lower()


SCRIPTS = [
    path
    for folder in ("scenarios", "scripts")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if "click.command" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_option_is_a_parameter_of_its_command(path):
    commands = list(_commands(path))
    assert commands
    for function, calls in commands:
        options = {
            _parameter(call)
            for call in calls
            if ast.unparse(call.func) in {"click.option", "click.argument"}
        }
        parameters = {a.arg for a in [*function.args.args, *function.args.kwonlyargs]}
        assert options <= parameters or function.args.kwarg is not None, function.name
