"""README, CONTRIBUTING and docs: every command that they show is one, every Python block runs."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys

import click
import pytest

from lunarsim.cli import main
from scripts.command_pages import page
from tests.worlds import ROOT, SCENARIOS

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def _blocks(path, *languages):
    text = path.read_text(encoding="utf-8")
    found = re.findall(r"^```(\w+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return [block for language, block in found if language in languages]


def _shown():
    """Yield page and words of every command: in blocks of shell, and between single backquotes."""
    for path in PAGES:
        lines = [line for block in _blocks(path, "sh", "bash") for line in block.splitlines()]
        plain = re.sub(r"^```.*?^```", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
        lines += [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", plain)]
        for line in lines:
            if re.match(r"(\.venv/bin/)?(lunarsim|python|make) ", line):
                yield path.name, shlex.split(line, comments=True)


COMMANDS = list(_shown())


def _parsed(words):
    """Parse the words of a command as the command line does, without running it."""
    command, name = main, "lunarsim"
    while isinstance(command, click.Group) and words and words[0] in command.commands:
        name, command, words = words[0], command.commands[words[0]], words[1:]
    if isinstance(command, click.Group):
        assert not words or words == ["--help"], words
        return
    if "--help" in words:
        words = [word for word in words if word != "--help"]
    for param in command.params:  # shown in prose without what it needs
        param.required = False
    above = click.Context(main, info_name="lunarsim", **main.context_settings)
    command.make_context(name, list(words), parent=above)


def test_commands_are_found():
    assert len(COMMANDS) > 60
    assert {"README.md", "first-flight.md", "campaigns.md"} <= {page for page, _ in COMMANDS}


@pytest.mark.parametrize(("name", "words"), COMMANDS, ids=lambda v: " ".join(v)[:60])
def test_what_is_shown_is_a_command(name, words, monkeypatch):
    monkeypatch.chdir(ROOT)
    kind, *rest = words
    if kind.endswith("lunarsim"):
        state = [(p, p.required) for c in _every(main) for p in c.params]
        try:
            _parsed(rest)
        finally:
            for param, required in state:
                param.required = required
    elif kind == "make":
        targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        assert rest[0] in targets
    elif rest[0] == "-m":
        assert rest[1] in {"pip", "pytest", "sphinx", "lunarsim.cli"}
    else:
        assert (ROOT / rest[0]).is_file()


def _every(group):
    for command in group.commands.values():
        yield command
        if isinstance(command, click.Group):
            yield from _every(command)


@pytest.mark.parametrize(
    ("name", "number"),
    [(p, i) for p in ("README.md", "docs/first-flight.md")
     for i in range(len(_blocks(ROOT / p, "python")))],
)  # fmt: skip
def test_python_that_is_shown_runs(name, number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenarios").symlink_to(SCENARIOS)
    block = _blocks(ROOT / name, "python")[number]
    exec(compile(block, f"{name}, Python block {number}", "exec"), {"__name__": "shown"})


def test_the_page_of_commands_is_what_the_commands_say():
    assert (ROOT / "docs" / "commands.md").read_text(encoding="utf-8") == page()


@pytest.mark.slow
def test_the_first_flight_goes_as_the_guide_says(tmp_path):
    for block in _blocks(ROOT / "docs" / "first-flight.md", "sh"):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            done = subprocess.run(
                [sys.executable, "-m", "lunarsim.cli", *words[1:]], cwd=tmp_path, check=False,
                capture_output=True, text=True,
            )  # fmt: skip
            assert done.returncode == 0, (line, done.stderr)
    told = {path.name for path in (tmp_path / "out" / "one").iterdir()}
    assert {"scenario.toml", "descent.png", "maps.png", "touchdown.png"} <= told
    assert (tmp_path / "out" / "compare" / "figures" / "comparison.png").is_file()


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    pytest.importorskip("myst_nb")
    command = [sys.executable, "-m", "sphinx", "-W", "-n", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, str(ROOT / "docs"), str(tmp_path / "site")], check=False, capture_output=True,
        text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "site" / "first-flight.html").is_file()
