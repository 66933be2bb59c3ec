"""Measure navigation errors and sums of innovations of a simulated flight."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lunarsim import Simulation
from lunarsim.evaluation.consistency import Consistency
from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.unscented import UnscentedFilter

SCENARIOS = Path(__file__).resolve().parents[1]
# Last words of the names of monitored quantities that correct nothing and are therefore not
# measurements: number of rocks found again, direction of shadows, and the position of scans that
# fit the map.
CHECKS = ("expected", "shadows", "fits")


def error_of(simulation: Simulation) -> np.ndarray:
    """Return the navigation error: position (m), velocity (m/s), attitude (rad).

    The error (9,) is truth minus estimate in the site frame (ENU).
    """
    state = simulation.state
    found = simulation.computer.navigation.estimate_in_site(simulation.time, state.mass)
    turn = quat_multiply(state.attitude, quat_conjugate(found.attitude))
    return np.concatenate(
        (
            state.position - found.position,
            state.velocity - found.velocity,
            quat_to_rotation_vector(turn),
        )
    )


def corrects_state(kind: str) -> bool:
    """Return whether a monitored quantity corrects the navigation state.

    `kind` is the name of the quantity. The filter only checks the other quantities.
    """
    return kind.rsplit(maxsplit=1)[-1] not in CHECKS


def nis_sums(navigation: Navigator | UnscentedFilter) -> dict[str, Consistency]:
    """Return the sums of normalised squared innovations (NIS) by kind of measurement."""
    return {
        kind: Consistency(w.nis_sum, w.dof)
        for kind, w in navigation.monitors.items() if corrects_state(kind)
    }  # fmt: skip


def subtract_sums(
    before: dict[str, Consistency], after: dict[str, Consistency]
) -> dict[str, Consistency]:
    """Return the innovation sums of a time interval, from those at its two ends."""
    none = Consistency()
    return {
        kind: Consistency(
            c.total - before.get(kind, none).total, c.degrees - before.get(kind, none).degrees
        )
        for kind, c in after.items()
    }
