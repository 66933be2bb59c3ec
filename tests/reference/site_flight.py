"""A flight to a site, cycle by cycle: laws from their equations, and a lander in plain steps."""

from __future__ import annotations

import math

import numpy as np

from tests.reference.descent import Lander
from tests.reference.guidance import (
    DivertSearch,
    LimitTimer,
    PolynomialGuidance,
    vertical_descent,
)


class SiteFlight:
    """One lander that flies to the sites it is given; its position estimate drifts steadily.

    Only numbers are read from the settings of the scenario; no law of the package is called.

    Parameters
    ----------
    y
        State at the start (15,), apart from attitude and thrust, which guidance commands.
    site, drift
        Where it lands (3,), and the velocity of the drift (2,).
    scenario, dynamics
        Settings, gravity and the step.
    """

    def __init__(self, y, site, drift, scenario, dynamics):
        software = scenario.software()
        self.approach, self.min_time_to_go = software.approach, software.guidance.min_time_to_go
        self.lander, self.gravity = dynamics.lander, dynamics.gravity
        self.drift, self.site, self.time, self.low = (
            np.array([*drift, 0.0]),
            site.copy(),
            0.0,
            False,
        )
        control, approach = software.control, software.approach
        # The attitude loop settles with 2 damping / frequency.
        self.lag = 2.0 * control.damping / control.frequency + self.lander.thrust_lag
        gains = control.frequency, control.damping, control.slew_limit
        heading = scenario.start.make().heading
        self.plain = Lander(y, dynamics, gains, heading, approach.max_tilt)
        self.v_f = np.array([*approach.arrival_velocity, -approach.vertical_speed])
        self.a_f = np.array(approach.arrival_acceleration)
        self.search = DivertSearch(self.lander, self.gravity, approach, self.v_f, self.a_f)
        self.arrival = self.left_to(self.site)
        self._restart()

    def _restart(self):
        self.law = PolynomialGuidance(self.gravity, self.lag, self.min_time_to_go)
        self.timer = LimitTimer()

    @property
    def estimate(self):
        """Estimated position and velocity (3,), and the mass."""
        y = self.plain.y
        return y[:3] + self.time * self.drift, y[3:6] + self.drift, y[13]

    def target(self, site):
        """Return the position (3,) at the end of the approach to a site."""
        approach = self.approach
        height = approach.vertical_altitude + self.lander.com_height
        return site + np.array([*approach.arrival_offset, height])

    def left_to(self, site):
        """Return the time-to-go to a site, s; NaN out of reach."""
        return self.search.time_to_go(*self.estimate, self.target(site))

    def decide(self, goal, time_scale, first):
        """Apply a decision; return whether its time scale is refused.

        `goal` (3,) is a new site (None: no change) and `time_scale` multiplies the time-to-go
        (None: no change).
        """
        if goal is None and time_scale is None and not first:
            return False
        site = self.site if goal is None else goal
        left, scale = self.left_to(site), 1.0 if time_scale is None else time_scale
        if math.isnan(left):
            return time_scale is not None
        admissible = time_scale is None or self.search.is_admissible(
            *self.estimate, self.target(site), scale * left
        )
        self.site = site.copy()
        self.arrival = self.time + left * (scale if admissible else 1.0)
        return not admissible

    def acceleration(self):
        """Return the thrust acceleration of this cycle (3,)."""
        approach, (r, v, mass) = self.approach, self.estimate
        altitude = r[2] - self.site[2] - self.lander.com_height
        self.low = (
            self.low
            or altitude <= max(approach.vertical_altitude, approach.takeover_altitude)
            or self.arrival - self.time <= approach.end_time_to_go
        )
        if self.low:
            touchdown = self.site + [0.0, 0.0, self.lander.com_height]
            speed = approach.descent_speed or approach.vertical_speed
            return vertical_descent(r, v, touchdown, speed, self.gravity, self.lag)
        wanted = self.law.command(
            r, v, self.target(self.site), self.v_f, self.a_f, self.time, self.arrival - self.time
        )
        limits = approach.max_tilt, self.lander.thrust_max
        if self.timer.is_exceeded(wanted, mass, *limits, self.time):
            left = self.left_to(self.site)
            if left > self.arrival - self.time:
                self.arrival = self.time + left
        return wanted

    def steered(self):
        """Give the start the attitude and thrust that guidance commands there."""
        thrust, attitude = self.plain.command(self.acceleration())
        self.plain.y[6:10], self.plain.y[14] = attitude, thrust
        self._restart()

    def cycle(self, steps):
        """Fly a cycle; yield the state after each step."""
        yield from self.plain.guided(self.acceleration(), steps)
        self.time += steps * self.plain.d.step
