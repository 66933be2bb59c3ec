"""No function has more than 60 lines without its docstring, or more than 20 arguments."""

import ast
from pathlib import Path

ROOT = Path(__file__).parent.parent
MOST_LINES, MOST_ARGUMENTS = 60, 20


def _too_large(path):
    """Return name, lines and arguments of the functions of a file that break the rule."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        lines = node.end_lineno - node.lineno + 1
        if ast.get_docstring(node) is not None:
            lines -= node.body[0].end_lineno - node.body[0].lineno + 1
        a = node.args
        arguments = len(a.posonlyargs + a.args + a.kwonlyargs) + bool(a.vararg) + bool(a.kwarg)
        if lines > MOST_LINES or arguments > MOST_ARGUMENTS:
            found.append((node.name, lines, arguments))
    return found


def test_functions_are_short_and_take_few_arguments():
    files = [
        p
        for name in ("lunarsim", "envs", "scripts", "scenarios")
        for p in (ROOT / name).rglob("*.py")
    ]
    assert len(files) > 100
    large = {
        (path.relative_to(ROOT).as_posix(), name): (lines, arguments)
        for path in files
        for name, lines, arguments in _too_large(path)
    }
    assert not large, f"over {MOST_LINES} lines or {MOST_ARGUMENTS} arguments: {large}"


def test_the_rule_is_seen_to_be_broken(tmp_path):
    path = tmp_path / "module.py"
    arguments = ", ".join(f"a{n}" for n in range(21))
    path.write_text(f"def wide({arguments}):\n    pass\n\n\ndef long():\n" + "    pass\n" * 60)
    assert _too_large(path) == [("wide", 2, 21), ("long", 61, 0)]
