"""The line of docs/howto/agents.md that installs MoviePy names all that it needs."""

from __future__ import annotations

import re
import subprocess
import sys
import sysconfig
import venv

import pytest

from tests.worlds import ROOT

_LINE = re.compile(r"`pip install (--no-deps moviepy [^`]+)`")


def test_the_line_names_what_moviepy_imports():
    (line,) = _LINE.findall((ROOT / "docs" / "howto" / "agents.md").read_text(encoding="utf-8"))
    # proglog imports tqdm.
    assert {"imageio", "imageio-ffmpeg", "proglog", "tqdm", "decorator"} <= set(line.split())


@pytest.mark.slow
def test_moviepy_is_imported_after_the_line(tmp_path):
    """In an environment that sees the packages of this one, as a user's does."""
    (line,) = _LINE.findall((ROOT / "docs" / "howto" / "agents.md").read_text(encoding="utf-8"))
    venv.create(tmp_path / "v", with_pip=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    seen = tmp_path / "v" / "lib" / version / "site-packages" / "seen.pth"
    seen.write_text(sysconfig.get_paths()["purelib"] + "\n", encoding="utf-8")
    python = tmp_path / "v" / "bin" / "python"
    installed = subprocess.run(
        [python, "-m", "pip", "install", "-q", *line.split()], check=False, capture_output=True
    )
    if installed.returncode:
        pytest.skip("pip reaches no package index")
    code = "import moviepy; print(moviepy.__file__)"
    done = subprocess.run([python, "-c", code], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert str(tmp_path) in done.stdout
