"""A flight to a site, cycle by cycle: the computer's own laws about a lander flown plainly."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.control.thrust import thrust_to_command
from lunarsim.onboard.guidance.limit_violation_monitor import LimitViolationMonitor
from lunarsim.onboard.guidance.path_guidance import PathGuidance
from lunarsim.onboard.guidance.vertical import VerticalDescent
from lunarsim.onboard.navigation.estimate import Estimate
from tests.reference.descent import Lander
from tests.reference.divert import best


class SiteFlight:
    """One lander that keeps to sites it is given; what it believes drifts at a constant velocity.

    Parameters
    ----------
    y
        State at the start (15,), attitude and thrust aside: those are what guidance asks for.
    site, slip
        Where it is to land (3,), and the velocity of the drift (2,).
    scenario, dynamics
        Settings, gravity and the step.
    """

    def __init__(self, y, site, slip, scenario, dynamics):
        self.scenario, self.software = scenario, scenario.software()
        self.lander, self.gravity = dynamics.lander, dynamics.gravity
        self.slip, self.site, self.time, self.low = np.array([*slip, 0.0]), site.copy(), 0.0, False
        control = self.software.control
        self.lag = control.response_time + self.lander.thrust_lag
        self.start = scenario.start.make()
        self.plain = Lander(
            y, dynamics, control.gains, self.start.heading, self.software.approach.max_tilt
        )
        self.strain = LimitViolationMonitor()
        self.vertical = VerticalDescent.for_lag(self.lag, self.gravity)
        self.arrival = self.left_to(self.site)
        self.law = self._law()

    def _law(self):
        g = self.software.guidance
        return PathGuidance(g.shape, self.gravity, lag=self.lag, min_time_to_go=g.min_time_to_go)

    @property
    def estimate(self):
        y = self.plain.y
        return Estimate(
            self.time,
            y[:3] + self.time * self.slip,
            y[3:6] + self.slip,
            y[6:10],
            y[10:13],
            y[13],
            np.zeros((9, 9)),
        )

    @property
    def altitude(self):
        return self.plain.y[2] - self.site[2] - self.lander.com_height

    def left_to(self, site):
        """Return the time-to-go to a site, s; NaN out of reach."""
        approach = self.software.approach
        return float(
            self.software.guidance.cost(
                self.estimate,
                approach.end(site[None], self.lander),
                self.lander,
                self.gravity,
                approach.limits,
            ).time_to_go[0]
        )

    def keeps_limits(self, site, left):
        """Tell whether the path to a site that takes so long, s, keeps all limits, sampled."""
        approach, lander, e = self.software.approach, self.lander, self.estimate
        end, limits = approach.end(site, lander), approach.limits
        margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
        increment = best(
            e.position, e.velocity, end.position, end.velocity, end.acceleration, [left], 24,
            self.gravity, e.mass, lander.exhaust_velocity, lander.thrust_min + margin,
            lander.thrust_max - margin, np.tan(limits.max_tilt), np.tan(limits.glideslope),
            self.software.guidance.shape.powers,
        )[0]  # fmt: skip
        burnt = e.mass * (1.0 - np.exp(-increment / lander.exhaust_velocity))
        return bool(burnt <= e.mass - lander.dry_mass - limits.reserve)

    def decide(self, goal, stretch, first):
        """Take a site, None keeps it, by a stretch, None leaves it; tell if it is not flown."""
        if goal is None and stretch is None and not first:
            return False
        site = self.site if goal is None else goal
        left = self.left_to(site)
        if not np.isfinite(left):
            return stretch is not None
        flown = stretch is None or self.keeps_limits(site, stretch * left)
        self.site = site.copy()
        self.arrival = self.time + left * (stretch if flown and stretch is not None else 1.0)
        return not flown

    def wanted(self):
        """Return the thrust acceleration of this cycle (3,)."""
        approach, e = self.software.approach, self.estimate
        self.low = self.low or approach.is_finished(self.altitude, self.arrival - self.time)
        if self.low:
            return self.vertical.command(
                e, approach.touchdown_end(self.site, self.lander), self.time
            )
        end = approach.end(self.site, self.lander)
        asked = self.law.command(e, end, self.time, self.arrival - self.time)
        most = approach.max_tilt, self.lander.thrust_max
        if self.strain.exceeds_duration(asked, e.mass, most, self.time):
            left = self.left_to(self.site)
            if left > self.arrival - self.time:
                self.arrival = self.time + left
        return asked

    def steered(self):
        """Give the start the attitude and thrust that guidance asks for there."""
        command = thrust_to_command(
            self.wanted(),
            self.plain.y[13],
            self.lander,
            self.start.heading,
            self.software.approach.max_tilt,
        )
        self.plain.y[6:10], self.plain.y[14] = command.attitude, command.thrust
        self.law, self.strain = self._law(), LimitViolationMonitor()

    def cycle(self, steps):
        """Fly a cycle; yield the state after each step."""
        yield from self.plain.guided(self.wanted(), steps)
        self.time += steps * self.plain.d.step
