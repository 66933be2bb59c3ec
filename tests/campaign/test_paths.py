"""Flights that differ in policy alone share their path, and end as if each had flown alone."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import pytest

from lunarsim.campaign.flight_execution import build_plan, fly_with_simulation
from lunarsim.campaign.plan import Group
from lunarsim.campaign.shared_paths import shared_path_classes
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.errors import InputError
from lunarsim.onboard.policies.contract import Decision
from lunarsim.simulation import Simulation, checkpoint
from tests.worlds import TINY_FLIGHT

POLICIES = ["no-divert", "safest", "nearest-safe", "truth-oracle"]
ROUGH = TINY_FLIGHT | {"rocks": {"cover": 0.15, "min_diameter_m": 0.4}}


@dataclass(frozen=True)
class Restless:
    """A policy from elsewhere."""

    name: str = "restless"

    def decide(self, observation):
        return Decision.keep("so be it")


def study(policies=POLICIES, **more):
    given = {
        "name": "p",
        "flights": 4,
        "seed": 5,
        "scenario": ROUGH,
        "factors": {"policy": policies},
    }
    return build_plan(CampaignSpec.from_dict(given | more)).work.study


def digest(flight, folder):
    flight.save(folder)
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return [hashlib.sha256(p.read_bytes()).hexdigest() for p in files]


@pytest.fixture
def cycles(monkeypatch):
    """Count the cycles that are flown."""
    count = []
    move = Simulation.move

    def counted(self):
        count.append(self.time)
        move(self)

    monkeypatch.setattr(Simulation, "move", counted)
    return count


def test_rows_and_records_are_those_of_flights_alone(tmp_path, cycles):
    known, parted, order = study(), 0, (1, 0, 3, 2)
    for index in (0, 1):
        memory: dict = {}
        group = Group(index, tuple(range(4)))
        cycles.clear()
        shared = {arm: fly_with_simulation(known, group, arm, memory) for arm in order}
        together = len(cycles)
        cycles.clear()
        for arm in order:
            alone = fly_with_simulation(
                known, Group(index, (arm,)), arm, memory | {("paths", 0): {}}
            )
            flight, _, row = shared[arm]
            assert repr(row) == repr(alone[2])
            assert row["policy"] == POLICIES[arm]
            a, b = (tmp_path / f"{index}-{arm}-{name}" for name in ("shared", "alone"))
            assert digest(flight, a) == digest(alone[0], b)
        parted += together > len(cycles) / 4 + 1
        # Up to the first scan nothing differs.
        assert together < 0.8 * len(cycles)
    assert parted, "no path has parted: nothing was tried"


def test_settings_and_names_of_policies_share_a_path_and_nothing_else_does(monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", __name__)
    arms = [
        {"name": "a", "set": {"policy": "safest"}},
        {"name": "b", "set": {"policy": {"kind": "nearest-safe", "p_safe_min": 0.5}}},
        {"name": "c", "set": {"policy": "safest", "sun.elevation_deg": 5.0}},
        {"name": "d", "set": {"policy": "tests.campaign.test_paths:Restless"}},
        {"name": "e", "set": {"policy": "no-divert", "sun.elevation_deg": 5.0}},
    ]
    given = {"name": "p", "flights": 4, "scenario": ROUGH, "arms": arms}
    spec = CampaignSpec.from_dict(given)
    assert shared_path_classes(spec.arms) == (0, 0, 2, 3, 2)


def test_where_no_copy_is_certain_flights_are_flown_apart(monkeypatch, cycles):
    def refuse(self, simulation):
        raise checkpoint.CheckpointError("no")

    known = study(["no-divert", "safest"])
    alone = [fly_with_simulation(known, Group(1, (arm,)), arm, {})[2] for arm in (0, 1)]
    cycles.clear()
    monkeypatch.setattr("lunarsim.campaign.shared_paths.Checkpoint.__init__", refuse)
    memory: dict = {}
    shared = [fly_with_simulation(known, Group(1, (0, 1)), arm, memory)[2] for arm in (0, 1)]
    assert repr(shared) == repr(alone)


def test_a_draw_that_another_arm_cannot_take_is_that_arms_alone():
    """A setting of one policy that is drawn, which the other does not have."""
    known = study(["nearest-safe", "no-divert"])
    group, memory = Group(0, (0, 1), {"policy.p_safe_min": 0.7}), {}
    assert fly_with_simulation(known, group, 0, memory)[2]["policy"] == "nearest-safe"
    with pytest.raises(InputError, match="p_safe_min"):
        fly_with_simulation(known, group, 1, memory)


def test_who_climbs_away_parts_from_who_lands():
    """Two that abort alike part from each other too: neither waits for the other without end."""
    away = {"kind": "safest-or-abort", "p_safe_min": 0.9999, "abort_altitude_m": 400.0}
    arms = [{"name": "a", "set": {"policy": "safest"}}]
    arms += [
        {"name": n, "set": {"policy": away | {"value_weight": w}}}
        for n, w in (("b", 0.5), ("c", 0.4))
    ]
    given = {"name": "p", "flights": 4, "seed": 5, "scenario": ROUGH, "arms": arms}
    known = build_plan(CampaignSpec.from_dict(given)).work.study
    memory: dict = {}
    shared = [fly_with_simulation(known, Group(0, (0, 1, 2)), arm, memory)[2] for arm in range(3)]
    alone = [fly_with_simulation(known, Group(0, (arm,)), arm, {})[2] for arm in range(3)]
    assert repr(shared) == repr(alone)
    assert [row["aborted"] for row in shared] == [False, True, True]
