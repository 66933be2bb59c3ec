"""Guidance laws from their equations: one lander, one sample and one trial time at a time."""

from __future__ import annotations

import math

import numpy as np

from tests.reference.attitude import along_thrust
from tests.reference.divert import best, path


def apollo_acceleration(r, v, target, v_f, a_f, time_to_go):
    """Return the acceleration (3,) of Klumpp's closed form (Automatica 10, 1974)."""
    return 12.0 * (target - r) / time_to_go**2 - 6.0 * (v_f + v) / time_to_go + a_f


class PolynomialGuidance:
    """Apollo guidance of a vehicle that responds to commands with a first-order lag.

    Parameters
    ----------
    gravity
        Downward acceleration, m/s^2.
    lag
        Time constant of the response, s.
    min_time_to_go
        Time-to-go below which the last path is flown without feedback, s.
    """

    def __init__(self, gravity, lag, min_time_to_go):
        self.gravity, self.lag, self.min_time_to_go = gravity, lag, min_time_to_go
        self.commands = []  # time and acceleration of every command
        self.last = None

    def response(self, time):
        """Return the acceleration (3,) of the vehicle: the sum of responses to all steps so far."""
        total, before = np.zeros(3), np.zeros(3)
        for start, command in self.commands if self.lag > 0.0 else []:
            total += (command - before) * (1.0 - math.exp(-(time - start) / self.lag))
            before = command
        return total

    def command(self, r, v, target, v_f, a_f, time, time_to_go):
        """Return the thrust acceleration (3,), m/s^2."""
        left = time_to_go - self.lag
        if left >= self.min_time_to_go or self.last is None:
            left = max(left, self.min_time_to_go)
            a = self.response(time)
            r, v = r + self.lag * v + 0.5 * self.lag**2 * a, v + self.lag * a
            self.last = time, left, r, v, target, v_f, a_f
            wanted = apollo_acceleration(r, v, target, v_f, a_f, left)
        else:
            since, left, *ends = self.last
            wanted = path(*ends, left, [min(time - since, left)])[1][0]
        self.commands.append((time, wanted))
        return wanted + [0.0, 0.0, self.gravity]


def max_tilt(height, full_tilt_height):
    """Return the maximum tilt in the vertical descent, rad: 2 deg at touchdown, 12 deg above."""
    return np.deg2rad(np.interp(height, [0.0, full_tilt_height], [2.0, 12.0]))


def vertical_descent(
    r, v, touchdown, planned, gravity, lag, propellant=math.inf, mass=1.0, exhaust=math.inf
):
    """Return the thrust acceleration (3,) of the vertical descent, m/s^2.

    `touchdown` (3,) is the position at touchdown, m, and `planned` the downward speed, m/s. The
    horizontal loop is a damped oscillator about the touchdown point. It moves towards this point at
    most so fast that 0.15 m/s are left at touchdown, after the actual descent while the lander
    returns.

    A lander that cannot stop its drift before touchdown (with half of the pull that the tilt limit
    allows here) descends more slowly, so that its speed reaches zero 3 m above the terrain with a
    drift of 0.6 m/s and more, proportionally lower with less; below it climbs. With 10 kg of
    `propellant` (kg, until empty) or less, it descends at a quarter of its speed or faster.

    A lander that cannot return from 1 to 20 m to 1 m beside the point descends more slowly too: in
    proportion to the missing part of the loop's speed, at up to a quarter of its speed. It does not
    return if it needs its propellant above 10 kg to descend, with its `mass`, kg, and `exhaust`
    velocity, m/s.

    In the last 2 s before touchdown, at the wanted speed, the horizontal command decreases to zero.
    """
    frequency, damping = 0.6, 1.1
    if lag > 0.0:
        frequency = min(frequency, 0.33 / lag)
    rate = frequency / (2.0 * damping)
    height, drift = r[2] - touchdown[2], math.hypot(v[0], v[1])
    offset = np.array(r[:2]) - np.array(touchdown[:2])
    distance = math.hypot(*offset)
    deceleration = 0.5 * gravity * math.tan(max_tilt(height, 8.0))

    def fastest(descent):
        return 0.15 + deceleration * max(height, 0.0) / descent

    stop, back = max(drift - 0.3, 0.0) / deceleration, 0.0
    seconds = max(height, 0.0) / planned
    if 1.0 < distance <= 20.0 and propellant - 10.0 > mass * gravity * seconds / exhaust:
        back = math.log(distance) / rate
    slips = stop > 0.0 and planned * stop > height
    speed = planned
    if slips and propellant <= 10.0:
        speed = max(height / stop, planned / 4.0)
    elif slips or (back > 0.0 and planned * max(stop, back) > height):
        hold = max(10.0 * (drift - 0.3), 3.0 * (distance - 1.0) if back > 0.0 else 0.0, 0.0)
        speed = max((height - min(hold, 3.0)) / max(stop, back), -0.5)
        if not slips:
            loop = min(rate * distance, fastest(planned / 4.0))
            closing = -float(offset @ np.array(v[:2])) / distance
            speed = max(speed, planned / 4.0 * (1.0 - min(max(closing / loop, 0.0), 1.0)))
    up = max(gravity + 1.5 * (-speed - v[2]), 0.3 * gravity)
    wanted = -rate * offset
    limit = fastest(max(speed, planned / 4.0) if back > 0.0 else planned)
    if np.linalg.norm(wanted) > limit:
        wanted *= limit / np.linalg.norm(wanted)
    side = 2.0 * damping * frequency * (wanted - np.array(v[:2]))
    limit = up * math.tan(max_tilt(height, 3.0 if slips else 8.0))
    share = min(1.0, limit / max(math.hypot(*side), 1e-300))
    if speed > 0.0:
        share *= min(max(height, 0.0) / speed / 2.0, 1.0)
    return np.array([share * side[0], share * side[1], up])


class LimitTimer:
    """Every command of a flight; a violation of a limit by 2 % counts once it lasts 0.5 s."""

    def __init__(self):
        self.since = []  # times of the violations without a break until now

    def is_exceeded(self, acceleration, mass, max_tilt, thrust_max, time):
        """Return whether a violation has lasted 0.5 s; it is then counted again from zero."""
        size = np.linalg.norm(acceleration)
        tilt = math.acos(acceleration[2] / size)
        if tilt > 1.02 * max_tilt or mass * size > 1.02 * thrust_max:
            self.since.append(time)
        else:
            self.since = []
        exceeded = bool(self.since) and time - self.since[0] >= 0.5 - 1e-9
        if exceeded:
            self.since = []
        return exceeded


def thrust_and_attitude(acceleration, mass, thrust_min, thrust_max, heading, max_tilt):
    """Return thrust (N) and attitude (4,) for a thrust acceleration (3,), its upward part first."""
    most = thrust_max / mass
    up = min(max(acceleration[2], 1e-3), most)
    side = np.array(acceleration[:2])
    limit = min(math.sqrt(most**2 - up**2), up * math.tan(max_tilt))
    if np.linalg.norm(side) > limit:
        side *= limit / np.linalg.norm(side)
    vector = np.array([*side, up])
    thrust = min(max(mass * np.linalg.norm(vector), thrust_min), thrust_max)
    return thrust, along_thrust(vector, heading)


class DivertSearch:
    """The search of the time-to-go with minimum delta-v, one time after the other.

    Parameters
    ----------
    lander, gravity
        Masses, thrust range and specific impulse of the lander; downward acceleration, m/s^2.
    limits
        Maximum tilt and glideslope (rad), propellant reserve (kg), and throttle margin.
    v_f, a_f
        Velocity and acceleration (3,) at the end of the approach.
    """

    def __init__(self, lander, gravity, limits, v_f, a_f):
        self.lander, self.gravity, self.limits = lander, gravity, limits
        self.v_f, self.a_f = np.array(v_f), np.array(a_f)
        self.exhaust = 9.80665 * lander.specific_impulse

    def fastest(self, r, v, target):
        """Return a time that no path beats, s: full thrust and gravity straight to the target."""
        pull = self.lander.thrust_max / self.lander.dry_mass + self.gravity
        # Distance = speed t + pull t^2 / 2.
        line = [0.5 * pull, np.linalg.norm(v), -np.linalg.norm(target - r)]
        return max(np.roots(line).real.max(), 1.0)

    def delta_v(self, r, v, mass, target, time, samples=24):
        """Return the delta-v of a path, m/s; inf if it violates a limit or comes too fast."""
        lander, limits = self.lander, self.limits
        margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
        return best(
            r, v, target, self.v_f, self.a_f, [time], samples, self.gravity, mass, self.exhaust,
            lander.thrust_min + margin, lander.thrust_max - margin, math.tan(limits.max_tilt),
            math.tan(limits.glideslope), math.tan(limits.max_tilt),
        )[0]  # fmt: skip

    def propellant(self, mass, delta_v):
        """Return the propellant for a delta-v, kg; inf if the reserve would be used."""
        burnt = mass * (1.0 - math.exp(-delta_v / self.exhaust))
        return burnt if burnt <= mass - self.lander.dry_mass - self.limits.reserve else math.inf

    def is_admissible(self, r, v, mass, target, time):
        """Return whether a path of a given time violates no limit."""
        cost = self.propellant(mass, self.delta_v(r, v, mass, target, time))
        return time >= self.fastest(r, v, target) and cost < math.inf

    def time_to_go(self, r, v, mass, target):
        """Return the time-to-go with minimum delta-v, s; NaN if no path is admissible."""
        speed = np.linalg.norm(v)
        first = self.fastest(r, v, target)
        hover = self.exhaust * math.log(mass / self.lander.dry_mass) + speed
        last = max((hover + np.linalg.norm(self.v_f)) / self.gravity, first)
        early = min(last, 8.0 * max(np.linalg.norm(target - r) / max(speed, 5.0), first))
        time, delta_v = self._search(r, v, mass, target, first, early)
        if math.isnan(time) and early < last:
            time, delta_v = self._search(r, v, mass, target, early, last)
        return time if self.propellant(mass, delta_v) < math.inf else math.nan

    def _search(self, r, v, mass, target, first, last):
        """Try 14 times in equal ratios, 40 if none is admissible; halve the ratio five times."""
        for count in (14, 40):
            times = np.geomspace(first, last, count)
            costs = [self.delta_v(r, v, mass, target, time, 8) for time in times]
            if min(costs) < math.inf:
                break
        time, ratio = times[np.argmin(costs)], times[1] / times[0]
        least = self.delta_v(r, v, mass, target, time)
        for _ in range(5 if min(costs) < math.inf else 0):
            ratio, middle = math.sqrt(ratio), time
            for near in (middle / ratio, middle * ratio):
                if first * (1.0 - 1e-12) <= near <= last * (1.0 + 1e-12):
                    cost = self.delta_v(r, v, mass, target, near)
                    if cost < least:
                        least, time = cost, near
        return (time, least) if least < math.inf else (math.nan, math.inf)
