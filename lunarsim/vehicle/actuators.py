"""Response of valves, gimbal, throttle and engine pulses to commands."""

from __future__ import annotations

import numpy as np

from lunarsim.models.jet_lander import JetLander
from lunarsim.typing import Array
from lunarsim.vehicle.dynamics import Dynamics, build_rig, thrust_axis
from lunarsim.vehicle.faults import Faults
from lunarsim.vehicle.slosh import SloshPendulums
from lunarsim.vehicle.state import State


class Actuators:
    """True thrusters, gimbal and throttle of one flight, with faults.

    A valve opens instantly with full force; a fraction of a step counts as that fraction of the
    force. A command replaces the rest of the previous one, but an open valve stays open for its
    minimum on-time. The gimbal moves towards the commanded angle at its rate, within its limit.
    Below its minimum continuous thrust, the engine runs in pulses with the commanded mean thrust.

    Parameters
    ----------
    lander
        Lander model.
    step
        Integration step, s.
    faults
        Faults of the vehicle.

    Attributes
    ----------
    gimbal
        Gimbal angles of the engine about body x and body y (2,), rad.
    spent
        Thruster propellant used, kg.
    on_time, firings
        On-time (s) and number of valve openings of each thruster (n,).
    commands
        Commands so far, each an array (5 + n,): time, s, commanded and true gimbal angles (2,),
        rad, and on-times from then on (n,), s.
    slosh_pendulums
        Sloshing propellant; None: no slosh.
    """

    def __init__(self, lander: JetLander, step: float, faults: Faults | None = None) -> None:
        self.lander = lander
        self.step = step
        self.faults = faults or Faults()
        self.faults.check_count(lander.thrusters.count)
        self._forces, self._torques = lander.thrusters.forces, lander.thrusters.torques
        n = lander.thrusters.count
        self._remaining_on_time = np.zeros(n)
        self._open_for = np.zeros(n)
        self._gimbal_command = np.zeros(2)
        self._throttle: float | None = None
        self._pulse, self._pulse_end, self._carried_pulse = 0.0, 0.0, 0.0
        # Pulses begin with a step: other periods would change the mean thrust.
        self._pulse_period = step * max(np.ceil(lander.engine.pulse_period / step - 1e-9), 1.0)
        self._time = 0.0
        self.gimbal = np.zeros(2)
        self.spent = 0.0
        self.on_time = np.zeros(n)
        self.firings = np.zeros(n, dtype=np.int64)
        self.commands: list[Array] = []
        self.slosh_pendulums = SloshPendulums(lander) if lander.slosh.tanks else None

    def command(self, on_times: Array, gimbal: Array) -> None:
        """Command on-times (n,), s, of the thrusters and gimbal angles (2,), rad."""
        least = self.lander.thrusters.min_on_time
        wanted = np.where(on_times > 0.0, np.maximum(on_times, least), 0.0)
        # A valve that has just opened cannot close before its minimum on-time.
        held = np.where(self._remaining_on_time > 0.0, np.maximum(least - self._open_for, 0.0), 0.0)
        left = np.maximum(wanted, held)
        self.firings += (left > 0.0) & (self._remaining_on_time <= 0.0)
        self._open_for[self._remaining_on_time <= 0.0] = 0.0
        self._remaining_on_time = left
        limit = self.lander.engine.gimbal_limit
        self._gimbal_command = np.clip(gimbal, -limit, limit)
        self.commands.append(np.hstack((self._time, self._gimbal_command, self.gimbal, left)))

    def set_throttle(self, commanded_thrust: float) -> float:
        """Set the throttle to a commanded thrust, N, within its limits and faults.

        Returns the thrust that the engines deliver, N; 0 shuts the engine down.
        """
        return self.faults.delivered(self._time, self._throttle_setting(commanded_thrust))

    def _throttle_setting(self, commanded_thrust: float) -> float:
        """Set the throttle and return its setting, N."""
        engine, stuck = self.lander.engine, self.faults.engine_stuck_from
        if stuck is not None and self._time >= stuck:
            self._throttle = self.faults.throttle(self._time, self._throttle, commanded_thrust)
            return self._throttle
        if commanded_thrust <= 0.0:
            self._throttle = 0.0
            return 0.0
        if self._throttle and abs(commanded_thrust - self._throttle) < engine.dead_band:
            return self._throttle
        thrust = min(max(commanded_thrust, self.lander.thrust_min), self.lander.thrust_max)
        if engine.has_gap and thrust > engine.gap_lower:
            middle = 0.5 * (engine.gap_lower + engine.gap_upper)
            thrust = engine.gap_upper if thrust > middle else engine.gap_lower
        elif engine.throttle_step > 0.0:
            thrust = engine.throttle_step * round(thrust / engine.throttle_step)
            # Quantization must not lead into the gap.
            most = engine.gap_lower if engine.has_gap else self.lander.thrust_max
            thrust = min(max(thrust, self.lander.thrust_min), most)
        self._throttle = thrust
        return thrust

    def advance(self, dynamics: Dynamics, state: State, throttle: float) -> State:
        """Return the lander's state one step later for a throttle setting, N.

        Gimbal, valves and thruster propellant are advanced too.
        """
        share = self._on_fractions()
        limit = self.step * self.lander.engine.gimbal_rate
        self.gimbal = self.gimbal + np.clip(self._gimbal_command - self.gimbal, -limit, limit)
        flow = self.lander.thrusters.propellant_flow * float(share.sum())
        rig = dynamics.on_moon(self.rig(share @ self._forces, flow))
        torque = share @ self._torques
        thrust = self.lander.thrust_scale * self._pulsed(throttle)
        if self.slosh_pendulums is None:
            moved = dynamics.advance_with_rig(state, thrust, torque, rig)
        else:
            moved = self.slosh_pendulums.advance(dynamics, state, thrust, torque, rig)
        self.spent += flow * self.step
        self.on_time += share * self.step
        self._open_for += np.minimum(self._remaining_on_time, self.step)
        self._remaining_on_time = np.maximum(self._remaining_on_time - self.step, 0.0)
        self._remaining_on_time[self._remaining_on_time < 1e-9] = 0.0
        self._time += self.step
        return moved

    def _pulsed(self, throttle: float) -> float:
        """Return the mean thrust of the next step, N, for a throttle setting, N.

        Time on or off that is shorter than the minimum pulse is carried to the next pulse. A pulse
        that ends within a step counts with its fraction of the step. The period is rounded up to
        a multiple of the step.
        """
        engine, level = self.lander.engine, self.lander.engine.continuous_min
        if not 0.0 < throttle < level:
            self._pulse_end = self._time
            return throttle
        if self._time >= self._pulse_end - 1e-9:
            period, shortest = self._pulse_period, engine.min_pulse
            wanted = period * throttle / level + self._carried_pulse
            on = wanted if wanted >= shortest else 0.0
            on = on if on <= period - shortest else period
            self._pulse, self._carried_pulse = on, wanted - on
            self._pulse_end = self._time + period
        on = min(self._pulse, self.step)
        self._pulse -= on
        return level * on / self.step

    def rig(self, force: Array, flow: float) -> Array:
        """Return forces and geometry of the lander as the array (21,) of `build_rig`.

        `force` (3,) is the total force of the thrusters, body axes, N, and `flow` their propellant
        flow, kg/s.
        """
        v = self.lander
        engine = thrust_axis(*(self.gimbal + v.thrust_misalignment))
        pivot = (0.0, 0.0, -v.engine.pivot_depth)
        return build_rig(
            force=force, flow=flow, engine=engine, pivot=pivot, com_dry=v.com_dry,
            com_full=v.com_full, spent=self.spent,
        )  # fmt: skip

    def _on_fractions(self) -> Array:
        """Return the fraction (n,) of the next step during which each thruster fires."""
        share = np.minimum(self._remaining_on_time, self.step) / self.step
        if self._time >= self.faults.jets_stuck_from:
            share[list(self.faults.jets_stuck_shut)] = 0.0
            share[list(self.faults.jets_stuck_open)] = 1.0
        wanted = self.lander.thrusters.propellant_flow * self.step * float(share.sum())
        left = self.lander.thrusters.propellant - self.spent
        return share * (left / wanted) if wanted > left else share
