"""Kernel caches: damaged files, folders that cannot be written to, users without a home."""

from __future__ import annotations

import os
import pwd
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from lunarsim.user_cache import ensure_caches, user_cache
from tests.worlds import ROOT

KERNELS = """
from lunarsim._jit import kernel

@kernel()
def doubled(x):
    return 2 * x
"""
# Compiles and saves, damages the files of one kind in every way, and loads again.
RUN = """
import importlib, sys
from pathlib import Path
from own import _own_kernels as own

def load():
    kernel = importlib.reload(own).doubled
    return kernel(21), len(kernel.stats.cache_hits)

def zeros(data):
    middle = len(data) // 2
    return data[:middle] + bytes(64) + data[middle + 64:]

print(load(), load())
for suffix in ("nbi", "nbc"):
    for damage in (lambda d: d[:100], lambda d: b"", lambda d: b"garbage" * 99, zeros):
        for file in Path("own/__pycache__").glob(f"*.{suffix}"):
            file.write_bytes(damage(file.read_bytes()))
        print(load(), load())
"""


@pytest.fixture
def own(tmp_path):
    """Return a folder with a package of one kernel."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "__init__.py").write_text("")
    (tmp_path / "own" / "_own_kernels.py").write_text(KERNELS)
    return tmp_path


def _run(folder, code, **environment):
    path = os.pathsep.join([str(ROOT), str(ROOT / "envs")])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=folder,
        env=os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": ""} | environment,
    )  # fmt: skip
    return done.stdout.splitlines(), done.stderr.splitlines()


def test_kernels_with_damaged_cache_files_are_compiled_again_with_one_warning(own):
    out, warnings = _run(own, RUN)
    assert out == ["(42, 0) (42, 1)"] * 9
    assert len(warnings) == 1
    assert "damaged files in the kernel cache" in warnings[0]


def test_a_kernel_folder_that_cannot_be_written_to_is_replaced(own):
    code = "from own._own_kernels import doubled as f; print(f(21))"
    out, warnings = _run(own, code, NUMBA_CACHE_DIR="/proc/none")
    assert out == ["42"]
    assert len(warnings) == 1
    assert "NUMBA_CACHE_DIR: cannot write to /proc/none" in warnings[0]
    assert list((own / "own" / "__pycache__").glob("*.nbi"))


@pytest.fixture
def no_home(tmp_path, monkeypatch):
    """Return the only folder for temporary files, for a user without a home or a name."""
    for variable in ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"):
        monkeypatch.setenv(variable, "")  # restored later, whatever the test sets
        monkeypatch.delenv(variable)

    def unknown(_):
        raise KeyError

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("home", [None, "/nonexistent", "~", "relative"])
def test_without_a_home_one_temporary_folder_serves_all_caches(no_home, home, monkeypatch, capsys):
    if home is not None:
        monkeypatch.setenv("HOME", home)
    ensure_caches()
    ensure_caches()
    folder = no_home / f"lunarsim-{os.getuid()}"
    assert user_cache("worlds") == folder / "lunarsim" / "worlds"
    assert Path(os.environ["MPLCONFIGDIR"]).is_relative_to(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert list(no_home.iterdir()) == [folder]
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert str(folder) in lines[0]


def test_a_temporary_folder_that_others_may_write_to_is_not_used(no_home):
    trap = no_home / f"lunarsim-{os.getuid()}"
    trap.mkdir()
    trap.chmod(0o777)
    ensure_caches()
    assert not user_cache("kernels").is_relative_to(trap)
    assert user_cache("kernels").is_relative_to(no_home)


def test_a_users_own_cache_is_kept(no_home, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(no_home))
    ensure_caches()
    assert user_cache("worlds") == no_home / ".cache" / "lunarsim" / "worlds"
    assert "MPLCONFIGDIR" not in os.environ
    assert capsys.readouterr().err == ""


def test_a_tilde_is_the_home_folder_or_nothing(no_home, monkeypatch, own):
    for variable in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"):
        monkeypatch.setenv(variable, "~/own")
    ensure_caches()
    assert "XDG_CONFIG_HOME" not in os.environ
    assert Path(os.environ["MPLCONFIGDIR"]).is_relative_to(no_home)
    monkeypatch.setenv("HOME", str(no_home))
    for variable in ("XDG_CACHE_HOME", "MPLCONFIGDIR"):
        monkeypatch.setenv(variable, "~/own")
    ensure_caches()
    assert user_cache("worlds") == no_home / "own" / "lunarsim" / "worlds"
    assert os.environ["MPLCONFIGDIR"] == str(no_home / "own")
    code = "from own._own_kernels import doubled as f; print(f(21))"
    assert _run(own, code, NUMBA_CACHE_DIR="~/kernels") == (["42"], [])
    assert list((no_home / "kernels").glob("own_*/*.nbi"))
    assert not (own / "~").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.getuid() != 0, reason="needs root to become another user")
@pytest.mark.parametrize("home", [["HOME=/nonexistent"], ["-u", "HOME"]])
def test_a_user_without_a_name_flies_from_a_read_only_install(tmp_path, home):
    work = Path(tempfile.mkdtemp())
    work.chmod(0o777)
    (work / "tmp").mkdir(mode=0o777)
    (work / "tmp").chmod(0o777)
    identity = [
        "setpriv", "--reuid", "12345", "--regid", "12345", "--clear-groups",
        "--inh-caps", "+dac_read_search", "--ambient-caps", "+dac_read_search",
    ]  # fmt: skip
    command = [sys.executable, "-B", "-m", "lunarsim", "compare", "golombek"]
    options = ["--policies", "no-divert", "--flights", "1", "--jobs", "1", "--out", "cmp"]
    path = os.pathsep.join([str(ROOT), str(ROOT / "envs")])
    done = subprocess.run(
        [*identity, "env", *home, f"TMPDIR={work}/tmp", f"PYTHONPATH={path}", *command, *options],
        capture_output=True, text=True, check=False, cwd=work,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("is used instead") == 1
    assert "Matplotlib" not in done.stderr
    assert {p.name for p in work.iterdir()} == {"cmp", "tmp"}
