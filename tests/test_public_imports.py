"""What users copy imports public names only; studies may import what they study."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import lunarsim
import lunarsim.api
import lunarsim.exports
import lunarsim.interface
import lunarsim.search
import lunarsim.studies
import lunarsim.studies.worst_case
import lunarsim.view
from tests.worlds import ROOT

PUBLIC = {
    "lunarsim": set(lunarsim.__all__) | {"__version__", "api"},
    "lunarsim.api": set(lunarsim.api.__all__),
    "lunarsim.exports": set(lunarsim.exports.__all__),
    "lunarsim.interface": set(lunarsim.interface.__all__),
    "lunarsim.search": set(lunarsim.search.__all__),
    "lunarsim.studies": set(lunarsim.studies.__all__),
    "lunarsim.studies.worst_case": set(lunarsim.studies.worst_case.__all__),
    "lunarsim.view": set(lunarsim.view.__all__),
}
# Packages of internals that studies of these packages measure, calibrate or plot.
STUDIED = tuple(
    f"lunarsim.{name}"
    for name in (
        "atomic_", "campaign", "console", "errors", "evaluation", "frames",
        "messages", "models", "onboard", "optimal", "parts", "rng", "rocks", "safety", "scenario",
        "sensors", "simulation", "untrusted_files", "vehicle", "viz", "world",
    )
)  # fmt: skip
# Names that studies import from inside the package. The number may only fall.
MOST_INTERNAL_NAMES = 166


def _imports(code: str):
    """Yield module and name of each import from the package."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "lunarsim":
            for alias in node.names:
                yield node.module, alias.name
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "lunarsim":
                    yield alias.name, ""


def _is_public(module: str, name: str) -> bool:
    return module in PUBLIC and (not name or name in PUBLIC[module])


def _code(path: Path) -> list[str]:
    """Return the Python code of a page: fenced blocks, without prompts and options of cells."""
    fence = re.compile(r"^ *```\{?(?:python|pycon|code-cell)[^\n]*\n(.*?)^ *```", re.M | re.S)
    found = []
    for block in fence.findall(path.read_text(encoding="utf-8")):
        prompted = re.findall(r"^ *(?:>>>|\.\.\.) ?(.*)$", block, re.M)
        lines = prompted or block.splitlines()
        found.append("\n".join(line for line in lines if not line.startswith((":", "%", "!"))))
    return found


PAGES = [
    ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")),
]  # fmt: skip


def test_pages_with_code_are_found():
    assert sum(bool(_code(path)) for path in PAGES) > 5


@pytest.mark.parametrize("path", PAGES, ids=lambda p: p.name)
def test_code_on_a_page_imports_public_names(path):
    found = []
    for block in _code(path):
        try:
            found += list(_imports(block))
        except SyntaxError:  # a fragment, as in a listing with "..."
            assert "import lunarsim" not in block and "from lunarsim" not in block, block
    assert not [one for one in found if not _is_public(*one)]


def test_studies_import_public_names_from_their_public_place():
    homes = {name: home for home, names in PUBLIC.items() for name in names}
    wrong, internal = [], set()
    for path in sorted((ROOT / "scenarios").rglob("*.py")):
        for module, name in _imports(path.read_text(encoding="utf-8")):
            if _is_public(module, name):
                continue
            internal.add((module, name))
            where = f"{path.relative_to(ROOT)}: {module}.{name}"
            if not module.startswith(STUDIED):
                wrong.append(where)
            elif name in homes and _same(module, name, homes[name]):
                wrong.append(f"{where} is public: import it from {homes[name]}")
    assert not wrong
    assert len(internal) <= MOST_INTERNAL_NAMES


def _same(module: str, name: str, home: str) -> bool:
    found = {m: __import__(m, fromlist=[name]) for m in (module, home)}
    return getattr(found[module], name) is getattr(found[home], name)
