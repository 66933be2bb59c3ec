"""Cached kernels are compiled anew when a kernel that they call has changed in another file."""

from __future__ import annotations

import subprocess
import sys

import pytest

from lunarsim._kernel_sources import sources_digest

INNER = """
from lunarsim._jit import kernel

@kernel(inner=True)
def inner(x):
    return x + {}
"""
OUTER = """
from lunarsim._jit import kernel
from pair._inner_kernels import inner

@kernel()
def outer(x):
    return inner(x)
"""


@pytest.fixture
def pair(tmp_path):
    folder = tmp_path / "pair"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "_inner_kernels.py").write_text(INNER.format(1))
    (folder / "_outer_kernels.py").write_text(OUTER)
    (folder / "constants.py").write_text("FACTOR = 2\n")
    return folder


def test_a_caller_is_compiled_anew_after_its_callee_has_changed(pair):
    def asked():
        code = "from pair._outer_kernels import outer as f; print(f(1), len(f.stats.cache_hits))"
        told = subprocess.run(
            [sys.executable, "-B", "-c", code], cwd=pair.parent, capture_output=True, text=True,
            check=True,
        )  # fmt: skip
        return told.stdout.split()

    assert asked() == ["2", "0"]
    assert asked() == ["2", "1"]
    (pair / "_inner_kernels.py").write_text(INNER.format(2))
    assert asked() == ["3", "0"]


def test_what_counts_are_files_of_kernels_and_constants_they_name(pair):
    def digest():
        return sources_digest("pair._outer_kernels", str(pair / "_outer_kernels.py"))

    first = digest()
    assert digest() == first
    (pair / "constants.py").write_text("FACTOR = 3\n")
    assert digest() == first
    (pair / "_outer_kernels.py").write_text("from pair.constants import FACTOR\n" + OUTER)
    second = digest()
    (pair / "constants.py").write_text("FACTOR = 4\n")
    assert len({first, second, digest()}) == 3
