"""A simulation kept as it stands and gone on with is the same flight, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.checkpoint import Checkpoint, CheckpointError
from tests.worlds import SCENARIOS, SMALL_SHADOW_FLIGHT, TINY_FLIGHT

# The quadtree's scenario over less ground.
SMALL_SWEEP = {
    "terrain": {"size_m": 200.0, "field_m": 70.0, "boulders": 150, "craters": 12},
    "start": {"position_m": [-220.0, 0.0, 150.0], "position_sigma_m": 1.0},
    "approach": {"time_to_go_s": 30.0},
    "tasking": {"flash": {"duration_s": 9.0, "rate_hz": 10.0, "size_m": 50.0}},
    "prior_map": {"size_m": 180.0},
    "sensors": {"flash": {"half_fov_tangent": 0.025}},
    "mappers": {"sites": {"size_m": 64.0}},
    "initial_uncertainty": {"position_m": 8.0},
}


def told(simulation: Simulation) -> tuple[bytes, ...]:
    """Return the record of a flight as bytes: trajectory, map and events."""
    flight = simulation.flight()
    parts = [v.tobytes() for v in flight.trajectory.values()]
    if flight.hazard_map is not None:
        parts += [flight.hazard_map.p_safe.tobytes(), flight.hazard_map.observed.tobytes()]
    return (*parts, repr(flight.events).encode(), repr(flight.decisions).encode(),
            flight.scans.tobytes(), flight.candidates.tobytes())  # fmt: skip


def goes_on_the_same(scenario: Scenario, seed: int, times: tuple[float, ...], end: float) -> None:
    """Keep a flight at times, fly it and what was kept to an end in turn, and compare."""
    flight, kept = Simulation(scenario, seed, "safest"), []
    left = list(times)
    while not flight.done and flight.time < end:
        if left and flight.time >= left[0] - 1e-9:
            kept.append(Checkpoint(flight))
            left.pop(0)
        flight.step()
    assert len(kept) == len(times)
    whole = told(flight)
    for one in kept:
        # Twice: the first must not change what the second goes on from.
        for _ in range(2):
            again = one.resumed()
            while not again.done and again.time < end:
                again.step()
            assert told(again) == whole
            assert again.world is flight.world
    assert told(flight) == whole


def test_a_flight_goes_on_as_it_would_have():
    goes_on_the_same(Scenario.from_dict(TINY_FLIGHT), 3, (0.0, 7.0, 20.0), 60.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["shadow", "quadtree", "instruments", "camera_and_lidar", "lunar_module"]
)
def test_flights_of_every_kind_go_on_as_they_would_have(name):
    """Cameras, sweeping lasers, both navigation filters, jets; up to where maps have been made."""
    if name == "quadtree":
        whole = Scenario.load(SCENARIOS / "morpheus.toml").changed(**SMALL_SWEEP)
        scenario, times, end = whole, (1.0, 12.0), 16.0
    elif name == "shadow":
        scenario, times, end = Scenario.from_dict(SMALL_SHADOW_FLIGHT), (1.0, 6.0), 9.0
    else:
        folder = SCENARIOS / "landers" if name == "lunar_module" else SCENARIOS
        scenario, times, end = Scenario.load(folder / f"{name}.toml"), (0.5, 5.0), 7.0
    goes_on_the_same(scenario, 2, times, end)


class Holder:
    """What a sensor from elsewhere might be; its module is not the package's."""


@pytest.mark.parametrize(
    "what", [lambda: None, Holder(), open, np.zeros(2).data], ids=["lambda", "own", "open", "view"]
)
def test_what_cannot_be_copied_with_certainty_is_refused(what):
    simulation = Simulation(Scenario.from_dict(TINY_FLIGHT), 1, "safest")
    simulation.computer.extra = what  # type: ignore[attr-defined]
    if what is open:
        Checkpoint(simulation)  # a function of the standard library, by name
        return
    with pytest.raises(CheckpointError):
        Checkpoint(simulation)


def test_arrays_over_the_same_memory_still_are_in_the_copy():
    simulation = Simulation(Scenario.from_dict(TINY_FLIGHT), 1, "safest")
    whole = np.arange(24.0).reshape(4, 6)
    fixed = whole[1:3]
    fixed.flags.writeable = False
    columns = np.asfortranarray(np.arange(12.0).reshape(3, 4))
    simulation.computer.extra = (  # type: ignore[attr-defined]
        whole[:, 2], whole, whole[::-1, 1:4], fixed, columns[1], columns, whole.T.view(np.int64),
    )  # fmt: skip
    a = simulation.computer.extra  # type: ignore[attr-defined]
    b = Checkpoint(simulation).resumed().computer.extra  # type: ignore[attr-defined]
    for one, other in zip(a, b, strict=True):
        assert one.dtype == other.dtype and np.array_equal(one, other)
        assert one.flags.writeable == other.flags.writeable
        assert not np.shares_memory(one, other)
    b[1][2, 2] = -1.0
    assert b[0][2] == b[2][1, 1] == b[3][1, 2] == -1.0
    b[5][1, 3] = -2.0
    assert b[4][3] == -2.0
    assert a[1][2, 2] == 14.0 and a[5][1, 3] == 7.0
