"""The check of words and names finds what it must, with file, line and the better word."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from tests.conftest import ROOT

CLEAN = '"""Store images."""\n\n\nclass Store:\n    """Store images at least once."""\n'


@pytest.fixture
def check(tmp_path):
    """Return a function that checks a module beside a clean one and returns the lines printed."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "lunarsim").mkdir()
    shutil.copy(ROOT / "scripts" / "lint_words.py", tmp_path / "scripts")
    phrases = '[[exception]]\nphrase = "at least"\nreason = "a bound"\n'
    (tmp_path / "scripts" / "allowed_words.toml").write_text(phrases)
    (tmp_path / "lunarsim" / "clean.py").write_text(CLEAN)

    def run(text, exceptions=""):
        (tmp_path / "lunarsim" / "other.py").write_text(text)
        (tmp_path / "scripts" / "allowed_words.toml").write_text(phrases + exceptions)
        done = subprocess.run(
            [sys.executable, tmp_path / "scripts" / "lint_words.py"],
            check=False, capture_output=True, text=True,
        )  # fmt: skip
        assert (done.returncode == 0) == (not done.stdout), done.stderr
        return done.stdout.splitlines()

    return run


def test_plain_text_has_no_finding(check):
    assert check('"""Return an image."""\n') == []


@pytest.mark.parametrize(
    ("text", "place", "word"),
    [
        ('"""Return a picture."""\n', "other.py:1:", "image"),
        ('"""Return it."""\n# The map says so.\nX = 1\n', "other.py:2:", "reports"),
        ('"""Return it."""\nX = "so many rocks are told"\n', "other.py:2:", "quantity"),
        ('"""Return it."""\n\n\ndef judged_map():\n    return 1\n', "other.py:4:", "field's term"),
        (f'"""{"Return " * 20}it."""\n', "other.py:1:", "at most 80"),
        ('"""Return it"""\n', "other.py:1:", "complete sentence"),
        (CLEAN, "other.py:4:", "lunarsim/clean.py:4"),
    ],
)
def test_a_finding_has_file_line_and_better_word(check, text, place, word):
    lines = check(text)
    assert lines and lines[0].startswith(f"lunarsim/{place}") and word in lines[0]


def test_an_exception_has_a_use(check):
    text = '"""Return a picture."""\n'
    exception = '\n[[exception]]\nfile = "lunarsim/other.py"\nword = "picture"\nreason = "a key"\n'
    assert check(text, exception) == []
    (line,) = check('"""Return an image."""\n', exception)
    assert "nothing in lunarsim/other.py needs the exception 'picture'" in line


@pytest.mark.parametrize(
    ("page", "text", "word"),
    [
        ("docs/page.md", "# Maps\n\nThe map tells it.\n", "docs/page.md:3:"),
        ("docs/page.md", "word " * 2001, "Split the page"),
        ("docs/reference/page.md", "word " * 2001, ""),
        ("docs/page.md", "```\nThe map tells it.\n```\n", ""),
    ],
)
def test_pages_are_checked_but_for_code_and_generated_length(check, tmp_path, page, text, word):
    (tmp_path / page).parent.mkdir(parents=True)
    (tmp_path / page).write_text(text)
    lines = check('"""Return an image."""\n')
    assert len(lines) == bool(word) and all(word in line for line in lines)
