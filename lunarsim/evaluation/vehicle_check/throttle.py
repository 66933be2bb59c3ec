"""Throttle range against the thrust that guidance commands on the nominal descent."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lunarsim.evaluation.vehicle_check.mission import Mission
from lunarsim.evaluation.vehicle_check.rows import CheckRow
from lunarsim.models.jet_lander import JetLander

# Downward acceleration left for corrections at touchdown: the gain of the vertical descent, 1.5
# 1/s, times a velocity error of 0.1 m/s.
_DOWNWARD_RESERVE_M_S2 = 0.15
# Maximum share of the approach with commands inside the throttle gap: about the share of the
# thrust range that planned paths reserve for feedback (approach.throttle_margin).
_MAX_GAP_SHARE = 0.1
# Relative excess at which the throttle leaves the lower range (`ThrottleRegions`).
_GAP_HYSTERESIS = 0.05


def throttle_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the checks of the throttle range.

    The commanded thrust is ``m |a + g|`` with the mass m by the rocket equation. At touchdown the
    minimum thrust must be below ``m (g - 0.15 m/s^2)``, so that the lander can still accelerate
    downwards.
    """
    lander, path, terminal = mission.lander, mission.approach.path, mission.terminal
    yield CheckRow(
        "approach-thrust-max", "throttle", "maximum thrust against the approach",
        float(path.thrust.max()), lander.thrust_max, "N",
        "Otherwise the lander does not brake as planned and falls short of the end of the "
        "approach: raise vehicle.thrust_max_n, or extend approach.time_to_go_s.",
        wanted_margin=0.05,
    )  # fmt: skip
    slack = 1e-3 if mission.software.approach.throttle_margin == 0.0 else 0.05
    yield CheckRow(
        "approach-thrust-min", "throttle", "minimum thrust against the approach",
        float(path.thrust.min()), lander.thrust_min, "N",
        "Otherwise the engine cannot throttle down far enough and the lander flies above its "
        "path: lower vehicle.thrust_min_n, or change start.velocity_m_s.", "at most", slack,
    )  # fmt: skip
    yield CheckRow(
        "terminal-thrust-max", "throttle", "maximum thrust against the terminal descent",
        float(terminal.thrust.max()), lander.thrust_max, "N",
        "Otherwise the lander cannot hold its rate of descent: raise vehicle.thrust_max_n, or "
        "lower approach.vertical_speed_m_s.", wanted_margin=0.1,
    )  # fmt: skip
    weight = mission.touchdown_mass * (mission.gravity - _DOWNWARD_RESERVE_M_S2)
    yield CheckRow(
        "terminal-thrust-min", "throttle", "minimum thrust against the terminal descent",
        min(float(terminal.thrust.min()), weight), lander.thrust_min, "N",
        "Otherwise the lander does not descend and climbs as its mass decreases: lower "
        "vehicle.thrust_min_n, or raise vehicle.dry_mass_kg.", "at most", 0.05,
    )  # fmt: skip
    yield from _gap_rows(mission)


def _gap_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the checks of an engine's forbidden throttle range."""
    lander = mission.lander
    if not (isinstance(lander, JetLander) and lander.engine.has_gap):
        return
    engine, path = lander.engine, mission.approach.path
    inside = (path.thrust > engine.gap_lower) & (path.thrust < engine.gap_upper)
    yield CheckRow(
        "gap-approach", "throttle", "share of the approach with commands inside the throttle gap",
        _MAX_GAP_SHARE, float(np.mean(inside)), "",
        "Otherwise the engine alternates between both ends of the gap and the lander leaves its "
        "path: change vehicle.engine.gap_lower_n and gap_upper_n, or approach.time_to_go_s.",
        "at most", 0.5,
    )  # fmt: skip
    yield CheckRow(
        "gap-hover", "throttle", "lower end of the throttle gap against the terminal descent",
        float(mission.terminal.thrust.max()), engine.gap_lower, "N",
        "Otherwise the engine cannot hover and jumps to the upper end of the gap: raise "
        "vehicle.engine.gap_lower_n above the weight at touchdown.",
        wanted_margin=2.0 * _GAP_HYSTERESIS,
    )  # fmt: skip
