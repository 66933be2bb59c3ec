"""A descent flown plainly: draws with Python's integers, motion by SciPy's rotations."""

from __future__ import annotations

import math

import numpy as np

from tests.reference.attitude import rotation_between
from tests.reference.dynamics import rate_of_change
from tests.reference.guidance import thrust_and_attitude

_WORD = 2**64


def uniform(key, count):
    """Return draw number `count` of a key by SplitMix64."""
    x = (int(key) + 0x9E3779B97F4A7C15 * (int(count) + 1)) % _WORD
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9 % _WORD
    x = (x ^ (x >> 27)) * 0x94D049BB133111EB % _WORD
    x ^= x >> 31
    return ((x >> 12) + 0.5) / 2**52


def normal(key, count):
    """Return a normal draw by Box and Muller."""
    first, second = uniform(key, count), uniform(key, count + 1)
    return math.sqrt(-2.0 * math.log(first)) * math.cos(2.0 * math.pi * second)


def begun(key, flight, start, aim, worlds):
    """Return world, target's east and north, and position and velocity about it, of a flight."""
    first = 16 * flight
    world = int(uniform(key, first) * worlds)
    target = [aim[k] + aim[2 + k] * (2.0 * uniform(key, first + 1 + k) - 1.0) for k in range(2)]
    off = np.array([normal(key, first + 3 + 2 * k) for k in range(6)])
    return world, target, start[:3] + start[6] * off[:3], start[3:6] + start[7] * off[3:]


def varied(key, flight, v):
    """Return what a flight draws of a `Variation`, by name."""
    key = int(key) ^ 0xD1342543DE82EF95
    u = [uniform(key, 26 * flight + k) for k in range(14)]

    def about(most, k):
        return most * (2.0 * u[k] - 1.0)

    def left(k):
        return v.min_remaining_fraction + (1.0 - v.min_remaining_fraction) * u[k]

    torque = [1.0, 1.0, 1.0]
    if u[11] < v.torque_failure:
        torque[int(3.0 * u[9])] = left(10)
    return {
        "payload_kg": about(v.payload, 0), "specific_impulse_s": about(v.specific_impulse, 1),
        "thrust_scale": about(v.thrust_scale, 2), "thrust_lag_s": about(v.thrust_lag, 3),
        "offset_x_m": about(v.thrust_offset, 4), "offset_y_m": about(v.thrust_offset, 5),
        "failure_time_s": v.latest_failure * u[6],
        "engine_effectiveness": left(7) if u[8] < v.engine_failure else 1.0,
        "torque_effectiveness_x": torque[0], "torque_effectiveness_y": torque[1],
        "torque_effectiveness_z": torque[2],
        "sensing_delay_s": v.sensing_delay * u[12], "actuation_delay_s": v.actuation_delay * u[13],
    }  # fmt: skip


ALIKE = {
    "payload_kg": 0.0, "specific_impulse_s": 0.0, "thrust_scale": 0.0, "thrust_lag_s": 0.0,
    "offset_x_m": 0.0, "offset_y_m": 0.0, "failure_time_s": math.inf, "engine_effectiveness": 1.0,
    "torque_effectiveness_x": 1.0, "torque_effectiveness_y": 1.0, "torque_effectiveness_z": 1.0,
}  # fmt: skip


class Lander:
    """One lander under an attitude loop on perfect gyroscopes, or under torques as given.

    Parameters
    ----------
    y
        State (15,).
    dynamics
        Gravity and step, the lander's figures.
    gains, heading, max_tilt
        Of the attitude loop; azimuth of body x; largest tilt of the thrust.
    drawn
        What its flight has drawn; see `varied`.
    """

    def __init__(self, y, dynamics, gains, heading, max_tilt, drawn=ALIKE):
        self.own, self.time = drawn, 0.0
        self.y, self.d, self.gains = y.copy(), dynamics, gains
        self.heading, self.max_tilt = heading, max_tilt
        self.rate = np.zeros(3)

    def command(self, acceleration):
        """Return thrust (N) and attitude (4,) for a thrust acceleration (3,)."""
        v, mass = self.d.lander, self.y[13] - self.own["payload_kg"]
        return thrust_and_attitude(
            acceleration, mass, v.thrust_min, v.thrust_max, self.heading, self.max_tilt
        )

    def guided(self, acceleration, steps):
        """Fly so many steps under a thrust acceleration; yield the state after each."""
        v, mass = self.d.lander, self.y[13] - self.own["payload_kg"]
        thrust, target = self.command(acceleration)
        full = (mass - v.dry_mass) / v.propellant_mass
        dry, wet = np.array(v.inertia_dry), np.array(v.inertia_full)
        inertia = dry + full * (wet - dry)
        frequency, damping, slew = self.gains
        for _ in range(steps):
            error = rotation_between(self.y[6:10], target)
            wanted = np.clip(frequency / (2.0 * damping) * error, -slew, slew)
            torque = inertia * 2.0 * damping * frequency * (wanted - self.rate)
            before = self.y[6:10].copy()
            yield self._step(thrust, np.clip(torque, -np.array(v.torque_max), v.torque_max))
            self.rate = rotation_between(before, self.y[6:10]) / self.d.step

    def driven(self, thrust, torque, steps):
        """Fly so many steps under a thrust and torques; yield the state after each."""
        for _ in range(steps):
            yield self._step(thrust, np.asarray(torque))

    def _step(self, thrust, torque):
        v, dt, y, own = self.d.lander, self.d.step, self.y, self.own
        failed = self.time >= own["failure_time_s"]
        left = [own[f"torque_effectiveness_{axis}"] for axis in "xyz"]
        torque = torque * np.array(left) if failed else torque
        torque = torque + y[14] * np.array([own["offset_y_m"], -own["offset_x_m"], 0.0])
        thrust = (
            thrust * (1.0 + own["thrust_scale"]) * (own["engine_effectiveness"] if failed else 1.0)
        )
        load = own["payload_kg"]
        args = (
            thrust, torque, self.d.gravity,
            9.80665 * (v.specific_impulse + own["specific_impulse_s"]),
            v.thrust_lag + own["thrust_lag_s"], v.dry_mass + load,
            v.dry_mass + v.propellant_mass + load,
            np.array(v.inertia_dry), np.array(v.inertia_full),
        )  # fmt: skip
        self.time += dt
        a = rate_of_change(y, *args)
        b = rate_of_change(y + 0.5 * dt * a, *args)
        c = rate_of_change(y + 0.5 * dt * b, *args)
        d = rate_of_change(y + dt * c, *args)
        y = y + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        y[6:10] /= np.linalg.norm(y[6:10])
        self.y = y
        return y


def wanted_velocity(position, target, lander, gravity):
    """Return the velocity that shaping asks for at a position, m/s, number by number."""
    away = [position[k] - target[k] for k in range(3)]
    away[2] = max(away[2] - lander.com_height, 0.0)
    far = math.sqrt(sum(one * one for one in away))
    brakes = 0.38 * (lander.thrust_max / (lander.dry_mass + lander.propellant_mass) - gravity)
    time = 4.0 + math.sqrt(far / (2.0 * brakes))
    below = 4.0 * 0.4 * lander.vertical_speed_limit
    sooner = 1.0 + 1.5 * 4.0 / time
    return [-away[0] * sooner / time, -away[1] * sooner / time, -(away[2] + below) / time]
