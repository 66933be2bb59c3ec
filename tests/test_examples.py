"""Every example in a docstring of the package gives what it says."""

from __future__ import annotations

import doctest
import importlib

import numpy as np
import pytest

from tests.worlds import ROOT

PACKAGE = ROOT / "lunarsim"
WITH_EXAMPLES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]


def test_examples_are_found():
    assert len(WITH_EXAMPLES) > 18


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_give_what_they_say(name):
    module = importlib.import_module(name)
    with np.printoptions(precision=4, suppress=True):
        done = doctest.testmod(module)
    assert done.attempted
    assert not done.failed
