"""Shared fixtures: a small flight; `tests.worlds` has small grounds."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

from lunarsim.scenario import Scenario
from tests.worlds import ROOT, SCENARIOS, SMALL_FLIGHT

pytest_plugins = ["tests.fresh_draws"]

__all__ = ["ROOT", "SCENARIOS"]

# The first example of a test may compile a kernel.
settings.register_profile(
    "kernels",
    deadline=None,
    max_examples=40,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("kernels")

# Imported modules and collected tests stay until the end.
gc.disable()


def pytest_collection_finish() -> None:
    """Collect garbage less often, and not in modules and tests."""
    gc.collect()
    gc.freeze()
    gc.enable()
    gc.set_threshold(20_000, 20, 20)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let processes take files from both ends of the list in turn.

    Neighbouring files use the same kernels. Two processes that start with neighbours would both
    compile these kernels.
    """
    if not hasattr(config, "workerinput"):
        return
    files = list(dict.fromkeys(item.path for item in items))
    turn = {path: min(2 * k, 2 * (len(files) - k) - 1) for k, path in enumerate(files)}
    items.sort(key=lambda item: turn[item.path])


@pytest.fixture(scope="session", autouse=True)
def _without_fsync() -> Iterator[None]:
    """Replace `os.fsync`: it waits for the disk, and no test interrupts the power supply."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture
def small_scenario() -> Scenario:
    """A quick flight over rolling ground: 96 x 96 pixels, a coarse map."""
    return Scenario.from_dict(SMALL_FLIGHT)
