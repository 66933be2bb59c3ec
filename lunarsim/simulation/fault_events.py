"""Events of the flight record for faults of sensors and actuators."""

from __future__ import annotations

from typing import Any

from lunarsim.scenario import Scenario


def fault_events(scenario: Scenario, time: float) -> list[dict[str, Any]]:
    """Return the starts and ends of a scenario's faults up to a time, s.

    Names are "fault-started" and "fault-ended". `fault` is the name of the table, or "thrusters",
    "throttle" or "engine" in `[faults]`.
    """
    found: list[tuple[float | None, str, dict[str, Any]]] = []
    faults = None if scenario.faults is None else scenario.faults.make()
    if faults is not None and faults.occurs:
        if faults.jets_stuck_shut or faults.jets_stuck_open:
            found.append((faults.jets_stuck_from, "fault-started", {"fault": "thrusters"}))
        found.append((faults.engine_stuck_from, "fault-started", {"fault": "throttle"}))
        found.append((faults.engine_loss_from, "fault-started", {"fault": "engine"}))
    for name, part in scenario.sensor_faults.items():
        fault, details = part.make(), {"fault": name, "kind": part.kind, "sensor": part.sensor}
        if not fault.occurs:
            continue
        found += [(fault.start, "fault-started", details), (fault.end, "fault-ended", details)]
    return [
        {"time": when, "name": name, **details}
        for when, name, details in found
        if when is not None and when <= time + 1e-9
    ]
