"""A command in a folder from somebody else runs no module that lies there."""

from __future__ import annotations

import subprocess
import sys

import pytest
import tomli_w

from tests.security.strange_parts import SOURCE
from tests.worlds import TINY_FLIGHT

# Modules that a command and its workers import, of the standard library and of packages.
NAMES = ("numpy", "multiprocessing", "signal", "random", "click", "numba", "pyarrow", "json")


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """Return a working folder with modules, and an entry point, that leave a mark."""
    source = f"open({str(tmp_path / 'mark')!r}, 'a').write(__name__ + ' ')\nraise ImportError"
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text(source)
    (tmp_path / "strange_parts.py").write_text(SOURCE.format(mark=str(tmp_path / "mark")))
    info = tmp_path / "strange-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: strange\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[lunarsim.policy]\nstrange = strange_parts:Mine\n")
    (tmp_path / "s.toml").write_text(tomli_w.dumps(TINY_FLIGHT))
    (tmp_path / "strange.toml").write_text(tomli_w.dumps({"policy": {"kind": "strange"}}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", ":".join(filter(None, sys.path)))
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return tmp_path


def python(*arguments):
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False)


def installed(source):
    """Run a program that does not look for modules in the working folder, as the command does."""
    return python("-c", f"import sys; sys.path.pop(0)\n{source}")


@pytest.mark.parametrize("how", ["lunarsim", "python -m lunarsim"])
def test_no_module_of_the_working_folder_is_imported(hostile, how):
    if how == "lunarsim":
        arguments = "sys.argv = ['lunarsim', 'scenario', 'check', 'strange.toml']"
        done = installed(f"{arguments}\nfrom lunarsim.__main__ import main; main()")
    else:
        done = python("-m", "lunarsim", "scenario", "check", "strange.toml")
    assert (
        done.returncode == 2 and "policy.kind: " in done.stderr and "got 'strange'" in done.stderr
    ), done.stderr
    assert not (hostile / "mark").exists(), (hostile / "mark").read_text()


def test_no_worker_imports_a_module_of_the_working_folder(hostile):
    start = "multiprocessing.get_context('spawn').Process(target=print, args=['flown']).start()"
    done = installed(
        f"import multiprocessing\nfrom lunarsim.cli_start import run\nrun(lambda: {start})"
    )
    assert not (hostile / "mark").exists(), (hostile / "mark").read_text()
    assert done.stdout == "flown\n", done.stderr


def test_a_module_that_the_user_typed_is_found_there(hostile):
    check = ("-m", "lunarsim", "scenario", "check", "s.toml")
    done = python(*check, "--set", "policy=strange_parts:Mine")
    assert done.returncode == 0, done.stderr
    assert (hostile / "mark").read_text() == "imported"


def test_settings_of_other_libraries_that_lie_there_run_nothing(tmp_path, monkeypatch):
    """Numba would load pickles from there in place of kernels, Matplotlib would run LaTeX."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", ":".join(filter(None, sys.path)))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    (tmp_path / ".numba_config.yaml").write_text(f"cache_dir: {tmp_path / 'kernels'}\n")
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    source = """
import matplotlib, numba
import lunarsim.triangulation
from lunarsim.viz.style import new_figure
new_figure(1.0, 1.0)
print(numba.config.CACHE_DIR, matplotlib.rcParams["text.usetex"])
"""
    done = python("-c", source)
    assert done.stdout.split() == [str(tmp_path / "kernels"), "False"], done.stderr
    assert not (tmp_path / "kernels").exists()
