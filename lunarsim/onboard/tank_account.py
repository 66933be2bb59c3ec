"""What is left in the tanks, by what engine and thrusters were asked for."""

from __future__ import annotations

from lunarsim.models.lander import Lander
from lunarsim.onboard.control.jets import JetLoop
from lunarsim.onboard.control.loop import AttitudeLoop


class TankAccount:
    """The lander's mass as its computer reckons it: tanks are not gauged.

    Thrusters burn from tanks of their own, which the dry mass counts as full.

    Parameters
    ----------
    lander
        As briefed, with full tanks.
    loop
        The attitude loop, which tells what it has ordered of thrusters, where there are any.

    Attributes
    ----------
    mass
        Of the lander, kg.
    """

    def __init__(self, lander: Lander, loop: AttitudeLoop) -> None:
        self.lander = lander
        self.loop = loop if isinstance(loop, JetLoop) else None
        self.mass = lander.wet_mass
        self._pulses = 0.0
        self._dry = self._jets_dry = False

    def burn(self, thrust: float, seconds: float) -> list[str]:
        """Take off what a thrust (N) has burnt and thrusters since; return what has become true.

        "thruster-tanks-empty" and "tanks-empty" are told once each: what is commanded from there
        on is not to be had.
        """
        told = []
        burnt, least = thrust * seconds / self.lander.exhaust_velocity, self.lander.dry_mass
        if self.loop is not None:
            held = self.loop.vehicle.thrusters.propellant
            pulses = min(self.loop.spent, held)
            if pulses == held and not self._jets_dry:
                self._jets_dry = True  # at once where they carry none
                told.append("thruster-tanks-empty")
            burnt, least = burnt + pulses - self._pulses, least - pulses
            self._pulses = pulses
        self.mass = max(self.mass - burnt, least)
        if self.mass == least and not self._dry:
            self._dry = True
            told.append("tanks-empty")
        return told
