"""Fixtures that import the scripts of `scenarios/` by folder and name."""

from __future__ import annotations

import importlib
import sys

import pytest

from tests.conftest import SCENARIOS


@pytest.fixture
def script(monkeypatch):
    """Import a script with its folder first on the path, as if it were run."""

    def load(folder, name):
        here = SCENARIOS / folder
        monkeypatch.syspath_prepend(here)
        # Folders have scripts of the same name.
        for file in here.glob("*.py"):
            monkeypatch.delitem(sys.modules, file.stem, raising=False)
        return importlib.import_module(name)

    return load
