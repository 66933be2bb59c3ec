"""Attitude loop at the gyroscope rate, between the control cycles of the computer."""

from __future__ import annotations

import numpy as np

from lunarsim._frame_kernels import rotation_vector_between
from lunarsim.messages.commands import Command
from lunarsim.models.lander import Lander
from lunarsim.onboard.component_errors import checked_vector
from lunarsim.onboard.control import _kernels as k
from lunarsim.onboard.control.attitude import ProportionalDerivative
from lunarsim.onboard.control.contract import AttitudeControl
from lunarsim.typing import Array


class AttitudeLoop:
    """Attitude loop at the gyroscope rate: propagates the attitude, computes torques.

    The onboard computer sets the commanded attitude once per control cycle; the loop runs between
    these cycles.

    Parameters
    ----------
    law
        Attitude control law.
    lander
        Lander, with its nominal inertia and maximum torque.
    step
        Sample period of the gyroscopes, s.

    Attributes
    ----------
    state
        Estimated attitude (4), rate (3), torque (3), concatenated: (10,).
    inertia
        Principal moments at the mass of the last command (3,), kg m^2.
    """

    def __init__(self, law: AttitudeControl, lander: Lander, step: float) -> None:
        self.law = law
        self.lander = lander
        self.step = step
        self.state = np.zeros(10)
        self.state[3] = 1.0
        self.inertia = lander.inertia(lander.wet_mass)
        self.target = self.state[:4].copy()
        self.torque_max = np.asarray(lander.torque_max, dtype=np.float64)

    @property
    def compiled(self) -> bool:
        """Whether a compiled implementation of the control law exists."""
        return type(self.law) is ProportionalDerivative

    @property
    def gains(self) -> Array:
        """Frequency, damping ratio and slew limit of the compiled control law (3,)."""
        assert isinstance(self.law, ProportionalDerivative)
        return self.law.gains

    def start_cycle(self, command: Command, attitude: Array, mass: float) -> None:
        """Set commanded attitude, estimated attitude (4,) and mass (kg) for a new cycle."""
        self.state[:4] = attitude
        self.inertia = self.lander.inertia(mass)
        self.set_command(command)

    def set_command(self, command: Command) -> None:
        """Set the commanded attitude, also within a cycle."""
        self.target = np.ascontiguousarray(command.attitude, dtype=np.float64)

    def torque(self) -> Array:
        """Compute and return the torque for the next gyroscope step (3,), body axes, N m."""
        if self.compiled:
            k.compute_torque(self.state, self.target, self.gains, self.inertia, self.torque_max)
            return self.state[7:].copy()
        error = np.empty(3)
        rotation_vector_between(self.state[:4], self.target, error)
        given = self.law.torque(error, self.state[4:7].copy(), self.inertia)
        wanted = checked_vector("control", self.law, "torque", given, "N m")
        self.state[7:] = np.clip(wanted, -self.torque_max, self.torque_max)
        return self.state[7:].copy()

    def propagate(self, increment: Array) -> None:
        """Propagate the attitude by the gyroscopes' angle increment of one step (3,), rad."""
        k.propagate_attitude(self.state, increment, self.step)

    def replay(self, increments: Array) -> Array:
        """Return torques (n, 3), N m, for recorded gyroscope increments (n, 3), rad.

        The results are bit-identical to alternating calls of `torque` and `propagate`.
        """
        if self.compiled:
            return np.asarray(
                k.replay(
                    self.state, self.target, self.gains, self.inertia, self.torque_max,
                    np.ascontiguousarray(increments), self.step,
                )
            )  # fmt: skip
        torques = np.empty((len(increments), 3))
        for n, increment in enumerate(increments):
            torques[n] = self.torque()
            self.propagate(increment)
        return torques
