"""Estimate the lander's mass from the commanded thrust."""

from __future__ import annotations

from lunarsim.models.lander import Lander
from lunarsim.onboard.control.jets import JetLoop
from lunarsim.onboard.control.loop import AttitudeLoop


class MassEstimator:
    """Estimates the lander's mass by integrating commanded propellant flow.

    The tanks have no gauges, so the mass is derived from the commands. Thrusters burn propellant
    from their own tanks. The dry mass includes full thruster tanks.

    Parameters
    ----------
    lander
        Lander known before the flight, with full tanks.
    loop
        Attitude loop. With thrusters, it provides the propellant of the commanded pulses.

    Attributes
    ----------
    mass
        Estimated mass of the lander, kg.
    """

    def __init__(self, lander: Lander, loop: AttitudeLoop) -> None:
        self.lander = lander
        self.loop = loop if isinstance(loop, JetLoop) else None
        self.mass = lander.wet_mass
        self._thruster_used = 0.0
        self._is_empty = self._thrusters_empty = False

    def update(self, thrust: float, seconds: float) -> list[str]:
        """Subtract the propellant burnt in an interval; return the names of new events.

        The events are "thruster-tanks-empty" and "tanks-empty", each returned once, when the tanks
        run empty. From then on, commanded thrust is not available.

        Parameters
        ----------
        thrust
            Commanded thrust of the main engine, N.
        seconds
            Duration of the interval, s.
        """
        events = []
        propellant, min_mass = thrust * seconds / self.lander.exhaust_velocity, self.lander.dry_mass
        if self.loop is not None:
            thruster_propellant = self.loop.vehicle.thrusters.propellant
            thruster_used = min(self.loop.propellant_used, thruster_propellant)
            if thruster_used == thruster_propellant and not self._thrusters_empty:
                self._thrusters_empty = True  # immediately for thrusters without propellant
                events.append("thruster-tanks-empty")
            propellant, min_mass = (
                propellant + thruster_used - self._thruster_used,
                min_mass - thruster_used,
            )
            self._thruster_used = thruster_used
        self.mass = max(self.mass - propellant, min_mass)
        if self.mass == min_mass and not self._is_empty:
            self._is_empty = True
            events.append("tanks-empty")
        return events
