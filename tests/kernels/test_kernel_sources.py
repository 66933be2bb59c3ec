"""A cached kernel is recompiled when the code or a constant that it is linked with has changed."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from lunarsim._kernel_sources import linked_modules

# Two packages: the caller's, and another one with kernels and constants that the caller uses.
FILES = {
    "caller/__init__.py": "",
    "caller/_kernels.py": """
from caller._constants import FACTOR
from caller._types import Pair
from lunarsim._jit import kernel
from library import _kernels as k, units
from library._more_kernels import (
    third,
)

@kernel()
def outer(x):
    pair = Pair(x, 0.0)
    return FACTOR * k.inner(pair.first) + units.METRE + third(x)
""",
    "caller/_constants.py": "from library.units import KILO\nFACTOR = 2.0 * KILO\n",
    "caller/_types.py": "from typing import NamedTuple\n\n"
    "class Pair(NamedTuple):\n    first: float\n    second: float\n",
    "library/__init__.py": "",
    "library/units.py": "KILO = 1000.0\nMETRE = 1.0\n",
    "library/_kernels.py": """
from lunarsim._jit import kernel

@kernel(inner=True)
def inner(x):
    return x + 1.0
""",
    "library/_more_kernels.py": """
from lunarsim._jit import kernel

@kernel(inner=True)
def third(x):
    return 0.0 * x
""",
}

# Imports the caller once per line of input, each time in a new process. The processes are forks of
# one that has Numba ready and neither of the packages.
RUN = """
import json, os, sys
import numba
import lunarsim._jit
numba.njit(lambda x: x + 1.0)(1.0)
for _ in sys.stdin:
    if os.fork() == 0:
        from caller._kernels import outer
        print(json.dumps([outer(1.0), sum(outer.stats.cache_hits.values())]), flush=True)
        os._exit(0)
    os.wait()
"""


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("packages")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def run(packages):
    """Return the kernel's value in a new process, and how many compiled kernels came from disk."""
    with subprocess.Popen(
        [sys.executable, "-B", "-c", RUN], cwd=packages, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as process:  # fmt: skip

        def once():
            process.stdin.write("\n")
            process.stdin.flush()
            return json.loads(process.stdout.readline())

        yield once
        process.stdin.close()


def test_a_caller_is_recompiled_after_each_change_of_what_it_is_linked_with(packages, run):
    def change(name, old, new):
        text = (packages / name).read_text()
        assert old in text
        (packages / name).write_text(text.replace(old, new))
        return run()

    assert run() == [4001.0, 0]
    assert run() == [4001.0, 1]
    # A called kernel of another package, which the caller imports as a module.
    assert change("library/_kernels.py", "x + 1.0", "x + 2.0") == [6001.0, 0]
    # A kernel that a parenthesised import over several lines names.
    assert change("library/_more_kernels.py", "0.0 * x", "5.0 * x") == [6006.0, 0]
    # A constant of an imported module, and one that reaches the caller through another module.
    assert change("library/units.py", "METRE = 1.0", "METRE = 3.0") == [6008.0, 0]
    assert change("library/units.py", "KILO = 1000.0", "KILO = 10.0") == [68.0, 0]
    # The order of the fields of a tuple class.
    swapped = "    second: float\n    first: float\n"
    assert change("caller/_types.py", "    first: float\n    second: float\n", swapped)[1] == 0
    # A change that no kernel can see recompiles nothing.
    assert change("library/units.py", "KILO", "# thousand, as SI has it\nKILO")[1] == 1


def test_kernels_of_the_environments_depend_on_those_of_the_simulator():
    import lunarsim_envs.descent._kernels  # noqa: F401

    linked = linked_modules("lunarsim_envs.descent._kernels")
    assert {
        "lunarsim_envs.descent._loop_kernels",  # from package import module as name
        "lunarsim.core.touchdown",
        "lunarsim._frame_kernels",  # through another kernel's module
    } <= linked
