"""Campaigns that tests compare with."""

from __future__ import annotations

import pytest

from lunarsim.campaign import store
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.run import run
from tests.campaign.processes import parts
from tests.campaign.subset_surrogate import planned
from tests.campaign.surrogate import plan


@pytest.fixture
def short_parts(monkeypatch):
    """Parts of 20 rows, flights handed out by 7."""
    monkeypatch.setattr(store, "PART_ROWS", 20)
    monkeypatch.setattr(store, "_ROWS_PER_BATCH", 7)


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Return the bytes of an uninterrupted campaign of 40 flights."""
    folder = tmp_path_factory.mktemp("whole") / "c"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "PART_ROWS", 20)
        ran = run(plan(), InlineEngine(), folder)
    assert (ran.state, ran.flown, ran.failed) == ("complete", 80, 0)
    return parts(folder)


@pytest.fixture(scope="session")
def whole_subset(tmp_path_factory):
    """Return the folder of an uninterrupted subset simulation."""
    folder = tmp_path_factory.mktemp("whole") / "c"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "PART_ROWS", 200)
        ran = run(planned("linear"), InlineEngine(), folder)
    assert (ran.state, ran.failed) == ("complete", 0)
    return folder
