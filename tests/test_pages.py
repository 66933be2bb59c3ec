"""README, CONTRIBUTING and docs: every command that they show is one, every Python block runs."""

from __future__ import annotations

import ast
import os
import re
import shlex
import subprocess
import sys

import click
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import lunarsim
from lunarsim.campaign.world_truth import SAFE_SHARE_COLUMNS
from lunarsim.cli import main
from lunarsim.core.touchdown import CAUSES
from lunarsim.evaluation.flight_metrics import COLUMNS as RESULT_COLUMNS
from lunarsim.parts import kinds
from scripts import reference_pages
from tests.worlds import ROOT, SCENARIOS

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NOTEBOOKS = [
    path for path in sorted((ROOT / "docs" / "tutorials").glob("*.md")) if path.name != "index.md"
]


def _blocks(path, *languages):
    text = path.read_text(encoding="utf-8")
    found = re.findall(r"^```(\S+).*?\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return [block for language, block in found if language in languages]


def _shown():
    """Yield page and words of every command: in blocks of shell, and between single backquotes."""
    for path in PAGES:
        lines = [line for block in _blocks(path, "sh", "bash") for line in block.splitlines()]
        plain = re.sub(r"^```.*?^```", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
        lines += [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", plain)]
        for line in lines:
            if re.match(r"(\.venv/bin/)?(lunarsim|python3?|make) ", line):
                yield path.name, shlex.split(line, comments=True)


COMMANDS = list(_shown())


def _parsed(words):
    """Parse the words of a command as the command line does, without running it."""
    command, name = main, "lunarsim"
    context = click.Context(main)
    while isinstance(command, click.Group) and words:
        found = command.get_command(context, words[0])
        if found is None:
            break
        name, command, words = words[0], found, words[1:]
    if isinstance(command, click.Group):
        assert words in ([], ["--help"], ["--version"]), words
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
        assert rest[1] in {"pip", "pytest", "sphinx", "venv", "lunarsim", "lunarsim.cli"}
    else:
        assert (ROOT / rest[0]).is_file()
        source = _with_neighbours(ROOT / rest[0])
        for word in rest[1:]:
            assert not word.startswith("--") or re.search(rf'["/]{word}\b', source), word


def _with_neighbours(path):
    """Return the source of a script, and of the files beside it that it imports."""
    source = path.read_text(encoding="utf-8")
    named = re.findall(r"^(?:from|import) (\w+)", source, re.MULTILINE)
    beside = [path.with_name(f"{name}.py") for name in named]
    source += "".join(p.read_text(encoding="utf-8") for p in beside if p.is_file())
    if "import OPTIONS" in source:  # the options of every search for the worst case
        source += (ROOT / "lunarsim" / "studies" / "worst_case.py").read_text(encoding="utf-8")
    if "study = Study(" in source:  # the options of every study, its repetitions and factors
        repeats = re.findall(r'repeats="(\w+)"', source)
        factors = re.findall(r"factor_help={(.*?)}", source, re.DOTALL)
        names = [*repeats, *re.findall(r'"(\w+)":', "".join(factors)), "seed", "jobs", "out"]
        source += " ".join(f'"--{name.replace("_", "-")}"' for name in names)
    return source


def _every(group):
    for command in group.commands.values():
        yield command
        if isinstance(command, click.Group):
            yield from _every(command)


@pytest.fixture(scope="module")
def fly():
    """Return `lunarsim.fly` that flies equal calls once."""
    original, flown = lunarsim.fly, {}

    def shared(scenario, **options):
        call = repr((scenario, sorted(options.items())))
        if call not in flown:
            flown[call] = original(scenario, **options)
        return flown[call]

    return shared


@pytest.mark.parametrize(
    ("name", "number"),
    [(p.relative_to(ROOT).as_posix(), i) for p in PAGES if p.name != "CONTRIBUTING.md"
     for i in range(len(_blocks(p, "python")))],
)  # fmt: skip
def test_python_that_is_shown_runs(name, number, tmp_path, monkeypatch, fly):
    """Those of CONTRIBUTING are files of a package that `tests/outside` flies."""
    monkeypatch.setattr(lunarsim, "fly", fly)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenarios").symlink_to(SCENARIOS)
    results = tmp_path / "DIR" / "results"
    results.mkdir(parents=True)
    pq.write_table(pa.table({"arm": ["a", "b"], "safe": [True, False]}), results / "part-0.parquet")
    block = _blocks(ROOT / name, "python")[number]
    code = compile(block, f"{name}, Python block {number}", "exec", dont_inherit=True)
    exec(code, {"__name__": "shown"})


def test_generated_pages_are_current():
    generated = reference_pages.pages()
    folder = ROOT / "docs" / "reference"
    on_disk = {path: (folder / path).read_text(encoding="utf-8") for path in generated}
    assert on_disk == generated
    assert "environments/retarget-v1.md" in generated and "scenario/sensors.md" in generated


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebooks_hold_python_and_images(path):
    """The build of the site runs them: see the slow test below."""
    cells = _blocks(path, "{code-cell}")
    assert len(cells) >= 5
    assert "plt.subplots" in "".join(cells)
    for cell in cells:
        ast.parse(cell)


def test_every_page_is_on_the_site():
    listed = {"index"}
    for path in (ROOT / "docs").rglob("*.md"):
        for block in _blocks(path, "{toctree}"):
            folder = path.parent.relative_to(ROOT / "docs")
            names = [line for line in block.splitlines() if line and not line.startswith(":")]
            listed |= {(folder / name).as_posix() for name in names}
    docs = ROOT / "docs"
    pages = {p.relative_to(docs).with_suffix("").as_posix() for p in docs.rglob("*.md")}
    assert pages == listed


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_links_between_files_lead_to_files(path):
    """The build of the site checks the links between its pages too: see the slow test below."""
    text = re.sub(r"^```.*?^```", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    links = re.findall(r"\]\((?!\w+:|#)([^)#\s]+)", text)
    assert not [link for link in links if not (path.parent / link).exists()]


def _run(line, folder):
    words = shlex.split(line, comments=True)
    assert words[0].endswith("lunarsim"), line
    command = [sys.executable, "-m", "lunarsim.cli", *words[1:]]
    done = subprocess.run(command, cwd=folder, check=False, capture_output=True, text=True)
    assert done.returncode == 0, (line, done.stderr)


# Pages whose commands run in order in one folder, and words of lines that need more files.
RUN = {
    "README.md": (),
    "docs/get-started/worlds.md": (),
    "docs/howto/agents.md": ("trained", "own_agents", "pip"),
    "docs/howto/calibrate.md": ("mine_refit", "after", "west", "east"),
    "docs/howto/exports.md": ("DIR",),
    "docs/explanation/guidance.md": (),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUN)
def test_commands_of_a_page_do_their_work(name, tmp_path):
    lines = [line for block in _blocks(ROOT / name, "sh") for line in block.splitlines()]
    lines = [line for line in lines if re.match(r"(\.venv/bin/)?lunarsim ", line)]
    lines = [line for line in lines if not any(word in line for word in RUN[name])]
    assert lines
    for line in lines:
        shown = line.partition("#")[0]
        _run(re.sub(r"--(flights|episodes) \d+", r"--\1 2", shown), tmp_path)
        for option, path in re.findall(r"--(out|truth) (\S+)", shown):
            assert (tmp_path / path).exists(), (line, option)


SPEC = """
name = "few"
scenario = "hirise.toml"
flights = 13
{method}
[factors]
policy = ["no-divert", "safest"]
[dispersions]
"start.velocity_m_s.0" = {{ kind = "normal", mean = 28.0, sigma = 1.0 }}
{more}
"""
IMPORTANCE = '[importance]\nshifts = { "start.velocity_m_s.0" = 1.0 }'


@pytest.mark.slow
def test_commands_of_campaigns_do_their_work(tmp_path):
    from lunarsim.scenario.shipped import copy_to

    copy_to("hirise", tmp_path / "hirise.toml")
    (tmp_path / "few.toml").write_text(SPEC.format(method="", more=""))
    rare = SPEC.format(method='method = "importance"', more=IMPORTANCE)
    (tmp_path / "rare.toml").write_text(rare)
    _run("lunarsim campaign run rare.toml --out rare", tmp_path)
    names = {"SPEC": "few.toml", "DIR": "few", "A": "few", "B": "few", "SCENARIO": "hirise.toml"}
    done = 0
    for line in _blocks(ROOT / "docs" / "howto" / "campaigns.md", "sh")[0].splitlines():
        words = shlex.split(line, comments=True)
        if "ray" in words:  # tests/campaign/test_ray.py
            continue
        words = [names.get(word, word) for word in words]
        if "rare" in words:
            words[words.index("few")] = "rare"
        if words[1] in ("sweep", "compare"):
            words[words.index("few")] = words[1]
            words += ["--flights", "1"]
        _run(shlex.join(words), tmp_path)
        done += 1
    assert done == 11
    assert (tmp_path / "few" / "report.html").is_file()
    assert (tmp_path / "results.csv").is_file()


@pytest.mark.slow
def test_the_first_flight_goes_as_the_guide_says(tmp_path):
    """From the installation on, in an environment of its own; the clone is given by its path."""
    start = ROOT / "docs" / "get-started"
    install = _blocks(start / "install.md", "sh")[0]
    blocks = _blocks(start / "first-flight.md", "sh")
    for line in install.splitlines():
        given = {".": str(ROOT), "python3": sys.executable}
        words = [given.get(word, word) for word in shlex.split(line)]
        subprocess.run(words, cwd=tmp_path, check=True, capture_output=True)
    here, programs = tmp_path / "empty", tmp_path / ".venv" / "bin"
    here.mkdir()
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    active = clean | {"PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    for line in "".join(blocks).splitlines():
        words = [programs / "lunarsim", *shlex.split(line)[1:]]
        done = subprocess.run(words, cwd=here, env=active, check=False, capture_output=True)
        assert done.returncode == 0, (line, done.stderr.decode())
    written = {path.name for path in (here / "out" / "one").iterdir()}
    assert {"scenario.toml", "descent.png", "maps.png", "touchdown.png"} <= written
    assert (here / "out" / "compare" / "figures" / "comparison.png").is_file()


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-W", "-n", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, str(ROOT / "docs"), str(tmp_path)], check=False, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    for path in NOTEBOOKS:
        assert 'src="../_images/' in (tmp_path / "tutorials" / f"{path.stem}.html").read_text()


def test_the_page_of_columns_has_every_column():
    page = (ROOT / "docs" / "reference" / "columns.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"`(\w+)`", page))
    assert {*RESULT_COLUMNS, *SAFE_SHARE_COLUMNS} <= shown


def test_pages_have_every_cause_of_failure_and_every_guidance_law():
    docs = ROOT / "docs"
    for page, names in (
        ("reference/columns.md", CAUSES),
        ("explanation/touchdown.md", CAUSES),
        ("explanation/guidance.md", kinds("guidance")),
    ):
        shown = set(re.findall(r"`([\w-]+)`", (docs / page).read_text(encoding="utf-8")))
        assert set(names) <= shown, page


def test_the_page_of_events_has_every_event_of_the_code():
    """Most events are written as `(time, "name", ...)`; other names are not found here."""
    page = (ROOT / "docs" / "reference" / "events.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"`([\w-]+)`", page))
    names = set()
    for path in (ROOT / "lunarsim").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        names |= set(re.findall(r'\((?:self\.)?_?time, "([a-z-]+)"', text))
        names |= set(re.findall(r'"name": "([a-z-]+)", "sensor"', text))
    assert len(names) > 10 and names <= shown, names - shown
