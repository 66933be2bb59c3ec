"""The page of verification names tests that exist, marks the slow ones, and links files."""

from __future__ import annotations

import ast
import re

import pytest

from tests.worlds import ROOT

PAGE = ROOT / "docs" / "validation" / "verification.md"
TEXT = PAGE.read_text(encoding="utf-8")
TESTS = re.findall(r"`([\w/]+\.py)::(\w+)`( \(slow\))?", TEXT)
LINKS = re.findall(r"\]\((?!https?:)([^)#]+)(?:#([^)]+))?\)", TEXT)


def defined_tests(source):
    """Return whether each test function is marked slow, by name, without an import."""
    return {
        node.name: any(ast.unparse(one) == "pytest.mark.slow" for one in node.decorator_list)
        for node in ast.parse(source).body
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }


def anchors(page):
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", one).strip().lower().replace(" ", "-") for one in headings}


def test_tests_are_found_with_their_marks():
    source = "@pytest.mark.slow\ndef test_a(): ...\ndef test_b(): ...\ndef helper(): ..."
    assert defined_tests(source) == {"test_a": True, "test_b": False}
    assert len(TESTS) == TEXT.count(".py::") > 50
    assert len(LINKS) > 20


@pytest.mark.parametrize(("file", "name", "slow"), TESTS, ids=lambda value: value.strip() or "fast")
def test_each_named_test_exists_and_is_marked(file, name, slow):
    found = defined_tests((ROOT / "tests" / file).read_text(encoding="utf-8"))
    assert name in found
    assert found[name] == bool(slow)


@pytest.mark.parametrize(("link", "anchor"), LINKS)
def test_each_link_has_its_file_and_heading(link, anchor):
    page = PAGE.parent / link
    assert page.is_file()
    assert not anchor or anchor in anchors(page)
