"""A custom part that returns no numbers, or the wrong shape, is named with what it returned."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.control.attitude import ProportionalDerivative
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import PathShape
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapperSettings
from lunarsim.onboard.policies.contract import Decision
from lunarsim.scenario import Scenario
from lunarsim.sensors.navigation_fix import NavigationFixErrors
from lunarsim.simulation import Simulation
from tests.worlds import TINY_FLIGHT

NAN = float("nan")


@pytest.fixture(autouse=True)
def _own_parts(monkeypatch):
    """Allow scenarios to name the parts of this file."""
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", __name__)


class _Law:
    def __init__(self, part, weight):
        self.part, self.surface_gravity = part, weight

    def command(self, estimate, end, time, time_to_go):
        upward = [0.0, 0.0, self.surface_gravity]
        return self.part.late if time > 2.0 else upward


@dataclass(frozen=True)
class NanLaw(PathLaw):
    """Hovers, then commands no numbers."""

    shape = PathShape(1.0, 2.0)
    late = (NAN, 0.0, 1.0)

    def build(self, briefing, lag):
        return _Law(self, briefing.surface_gravity)


@dataclass(frozen=True)
class FlatLaw(NanLaw):
    """Hovers, then commands two numbers."""

    late = (0.0, 1.0)


@dataclass(frozen=True)
class WordLaw(NanLaw):
    """Commands a word from the start on."""

    def build(self, briefing, lag):
        return _Law(self, "up")


@dataclass(frozen=True)
class ComplexLaw(NanLaw):
    """Commands complex numbers from the start on."""

    def build(self, briefing, lag):
        return _Law(self, 1.0 + 1.0j)


@dataclass(frozen=True)
class SilentLaw(NanLaw):
    """Hovers, then commands nothing."""

    late = None


@dataclass(frozen=True)
class NanSite:
    """Diverts to nowhere."""

    name = "nan-site"
    answer = Decision(np.array([NAN, 0.0, 0.0]), "anywhere")

    def decide(self, observation):
        return self.answer


@dataclass(frozen=True)
class FlatSite(NanSite):
    """Diverts to a point of a plane."""

    answer = Decision(np.zeros(2), "flat")


@dataclass(frozen=True)
class NoDecision(NanSite):
    """Gives a word."""

    answer = "north"


@dataclass(frozen=True)
class NanTorque(ProportionalDerivative):
    """Asks for no number."""

    def torque(self, error, rate, inertia):
        return np.full(3, NAN)


@dataclass(frozen=True)
class WordFixes(NavigationFixErrors):
    """Gives a number without its time."""

    def build(self, rng, step):
        return self

    def measure(self, world, state, time, rng, mount=None):
        return 12.5


class _BadMaps:
    def __init__(self, mapper, change):
        self._mapper, self._change = mapper, change

    def __getattr__(self, name):
        return getattr(self._mapper, name)

    def hazard_map(self):
        return self._change(self._mapper.hazard_map())


@dataclass(frozen=True)
class NanMapping(GaussianDemMapperSettings):
    """Maps no probabilities."""

    def build(self, *given):
        return _BadMaps(super().build(*given), self.change)

    @staticmethod
    def change(m):
        return replace(m, p_safe=np.full_like(m.p_safe, NAN))


@dataclass(frozen=True)
class SmallMapping(NanMapping):
    """Maps fewer cells than its grid has."""

    @staticmethod
    def change(m):
        return replace(m, p_safe=m.p_safe[:-1])


@dataclass(frozen=True)
class NoMapping(NanMapping):
    """Gives an array in place of a map."""

    @staticmethod
    def change(m):
        return m.p_safe


def _of(part):
    return {"kind": f"{__name__}:{part}"}


SENSORS, DEM = TINY_FLIGHT["sensors"], TINY_FLIGHT["mappers"]["dem"]
CASES = [
    ({"guidance": _of("NanLaw")}, "guidance", "NanLaw", "got (nan, 0.0, 1.0)"),
    ({"guidance": _of("FlatLaw")}, "guidance", "FlatLaw", "got (0.0, 1.0)"),
    ({"guidance": _of("SilentLaw")}, "guidance", "SilentLaw", "got None"),
    (
        {"braking": {"law": f"{__name__}:NanLaw"}}, "braking.law", "NanLaw",
        "got (nan, 0.0, 1.0)",
    ),
    (
        {"braking": {"law": f"{__name__}:SilentLaw"}}, "braking.law", "SilentLaw",
        "got None",
    ),
    ({"guidance": _of("WordLaw")}, "guidance", "WordLaw", "got [0.0, 0.0, 'up']"),
    ({"guidance": _of("ComplexLaw")}, "guidance", "ComplexLaw", "got [0.0, 0.0, (1+1j)]"),
    ({"policy": _of("NanSite")}, "policy", "NanSite", "got [nan, 0.0, 0.0]"),
    ({"policy": _of("FlatSite")}, "policy", "FlatSite", "got [0.0, 0.0]"),
    ({"policy": _of("NoDecision")}, "policy", "NoDecision", "got 'north'"),
    ({"control": _of("NanTorque")}, "control", "NanTorque", "got [nan, nan, nan]"),
    (
        {"sensors": SENSORS | {"fix": _of("WordFixes")}, "navigation": {"kind": "fixes"}},
        "sensors.fix", "WordFixes", "got 12.5",
    ),
    ({"mappers": {"dem": DEM | _of("NoMapping")}}, "mappers.dem", "NoMapping", "a HazardMap"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "field", "part", "said"), CASES, ids=[f"{c[1]}-{c[2]}" for c in CASES]
)
def test_part_and_value_are_named(changes, field, part, said):
    scenario = Scenario.from_dict(TINY_FLIGHT | {"policy": {"kind": "safest"}} | changes)
    with pytest.raises(InputError) as refused:
        Simulation(scenario, 1, scenario.policy.kind).run()
    assert refused.value.field == field
    assert f"{__name__}:{part}." in refused.value.problem
    assert " must return " in refused.value.problem
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("part", "field", "value"),
    [
        ("NanMapping", "p_safe[0, 0]", pytest.approx(NAN, nan_ok=True)),
        ("SmallMapping", "p_safe", (79, 80)),
    ],
)
def test_the_mapper_of_wrong_arrays_is_named(part, field, value):
    scenario = Scenario.from_dict(TINY_FLIGHT | {"mappers": {"dem": DEM | _of(part)}})
    with pytest.raises(InputError) as refused:
        Simulation(scenario, 1, "safest").run()
    assert refused.value.field == f"mappers.dem.{field}"
    assert refused.value.value == value
