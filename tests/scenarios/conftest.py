"""Scripts of `scenarios/`, imported by folder and name."""

from __future__ import annotations

import importlib
import sys

import pytest

from tests.conftest import SCENARIOS


@pytest.fixture
def script(monkeypatch):
    """Import a script as if it were run: its folder first on the path, its neighbours its own."""

    def load(folder, name):
        here = SCENARIOS / folder
        monkeypatch.syspath_prepend(here)
        # Folders have scripts of the same name.
        for file in here.glob("*.py"):
            monkeypatch.delitem(sys.modules, file.stem, raising=False)
        return importlib.import_module(name)

    return load
