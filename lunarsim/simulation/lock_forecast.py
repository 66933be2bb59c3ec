"""Forecast whether navigation can lock onto the prior map, before a flight."""

from __future__ import annotations

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.navigation.map_features import LockForecast, forecast_lock

# Side of the terrain seen by a lander without a sweep, approximate, m.
_DEFAULT_SWEEP_M = 40.0


def lock_forecast(briefing: Briefing) -> LockForecast | None:
    """Forecast whether LiDAR scans will match the prior map at one place only.

    `briefing` has the data known before flight. Return None if navigation uses no prior map.
    """
    software = briefing.software
    if briefing.prior_map is None or not software.navigation.uses_prior_map:
        return None
    sizes = [float(getattr(part, "size", 0.0)) for part in software.tasking.values()]
    swept = max(sizes, default=0.0) or _DEFAULT_SWEEP_M
    east, north = (float(v) for v in briefing.target[:2])
    sigma = max(briefing.start.position_sigma, briefing.prior_map.grid.posting)
    return forecast_lock(briefing.prior_map, (east, north), swept, sigma)
