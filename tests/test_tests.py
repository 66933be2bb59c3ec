"""What tests may do: no private names, no other test's names."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

from tests.conftest import ROOT

TESTS = ROOT / "tests"


@cache
def _nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def _private(path: Path) -> list[str]:
    """Return private attributes that a file reads of anything but itself, and private imports."""
    found = []
    for node in _nodes(path):
        if isinstance(node, ast.Attribute) and node.attr.startswith("_"):
            own = isinstance(node.value, ast.Name) and node.value.id in {"self", "cls"}
            public = node.attr in {"_asdict", "_fields", "_replace"}  # of a NamedTuple
            if not own and not public and not node.attr.startswith("__"):
                found.append(f"{node.lineno}: .{node.attr}")
        elif isinstance(node, ast.ImportFrom):
            names = [a.name for a in node.names if a.name.startswith("_")]
            # Kernels have private modules and are what references are compared with.
            found += [
                f"{node.lineno}: {n}"
                for n in names
                if not n.endswith(("kernels", "_lanes", "_jit"))
            ]
    return found


def _other_tests(path: Path) -> list[str]:
    """Return the test modules that a file imports."""
    modules = [n.module or "" for n in _nodes(path) if isinstance(n, ast.ImportFrom)]
    modules += [a.name for n in _nodes(path) if isinstance(n, ast.Import) for a in n.names]
    return [m for m in modules if m.split(".")[-1].startswith("test_")]


def test_tests_touch_no_private_names():
    found = {p.relative_to(TESTS): _private(p) for p in TESTS.rglob("*.py")}
    assert len(found) > 60
    assert not {path: names for path, names in found.items() if names}


def test_no_test_imports_another():
    found = {p.relative_to(TESTS): _other_tests(p) for p in TESTS.rglob("*.py")}
    assert not {path: names for path, names in found.items() if names}


def test_kernels_are_imported_by_their_own_tests_only():
    """Other tests check the same behaviour through public names."""
    found = {}
    for path in TESTS.rglob("*.py"):
        if "kernels" in path.relative_to(TESTS).parts:
            continue
        imports = [n for n in _nodes(path) if isinstance(n, ast.ImportFrom)]
        modules = [n.module or "" for n in imports]
        modules += [f"{n.module}.{a.name}" for n in imports for a in n.names]
        kernels = {m for m in modules if re.search(r"^lunarsim.*\._(\w*kernels|simd|jit)$", m)}
        if kernels:
            found[path.relative_to(TESTS).as_posix()] = kernels
    assert not found


def test_references_import_nothing_of_what_they_check():
    """References receive settings and data as arguments and call no law of the package."""
    found = {}
    for path in (TESTS / "reference").glob("*.py"):
        modules = [n.module or "" for n in _nodes(path) if isinstance(n, ast.ImportFrom)]
        modules += [a.name for n in _nodes(path) if isinstance(n, ast.Import) for a in n.names]
        found[path.name] = [m for m in modules if m.startswith("lunarsim")]
    assert len(found) > 20
    assert not {name: modules for name, modules in found.items() if modules}


def test_tests_stand_where_their_rooms_do():
    """Every folder of tests is a room of the package, the environments', or says what it is for."""
    others = {"kernels", "reference", "outside", "envs", "scenarios", "scripts", "security"}
    rooms = {p.name for p in (ROOT / "lunarsim").iterdir() if p.is_dir()}
    folders = {p.name for p in TESTS.iterdir() if p.is_dir() and p.name != "__pycache__"}
    assert folders <= rooms | others
