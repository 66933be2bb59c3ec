"""Apollo polynomial guidance.

Klumpp, "Apollo lunar descent guidance", Automatica 10, 1974.

Given current position and velocity, and position, velocity and acceleration at the target after a
time-to-go T, exactly one acceleration quadratic in time solves the boundary value problem. The law
solves it in every cycle, which closes the loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.value_checks import check_finite


@dataclass(frozen=True)
class ApolloLaw(PathLaw):
    """Settings of the Apollo polynomial guidance law (Klumpp 1974).

    The law itself is the `PathGuidance` that `build` returns for one flight.
    """

    @property
    def shape(self) -> PathShape:
        """Shape of the paths: acceleration with linear and quadratic terms of time-to-go."""
        return APOLLO


def jerk_time_to_go(
    position: float,
    velocity: float,
    end: tuple[float, float, float],
    jerk: float,
    *,
    guess: float,
) -> float:
    """Return the time-to-go (s) of a quartic path with a given final jerk.

    It is the positive root of ``J T^3 - 6 A T^2 + (18 V_f + 6 V) T - 24 (R_f - R) = 0`` nearest to
    the guess (Klumpp's cubic, which counts T negative); NaN if no root is positive.

    Parameters
    ----------
    position, velocity
        Current downrange position and velocity, m and m/s.
    end
        Downrange position, velocity and acceleration at the target, m, m/s, m/s^2.
    jerk
        Downrange jerk at the target, m/s^3.
    guess
        Time-to-go of the previous cycle, s.

    Raises
    ------
    InputError
        If an argument is not finite.
    """
    r_f, v_f, a_f = end
    c = np.array([jerk, -6.0 * a_f, 18.0 * v_f + 6.0 * velocity, -24.0 * (r_f - position)])
    if not (np.isfinite(c).all() and np.isfinite(guess)):
        for name, value in (
            ("position", position), ("velocity", velocity), ("end", end), ("jerk", jerk),
            ("guess", guess),
        ):  # fmt: skip
            check_finite(name, value)
    roots = np.roots(c)
    real = roots.real[np.abs(roots.imag) <= 1e-9 * np.maximum(1.0, np.abs(roots))]
    real = real[real > 0.0]
    return float(real[np.argmin(np.abs(real - guess))]) if real.size else float("nan")


def time_to_go_for_jerk(
    estimate: Estimate, end: PhaseEnd, jerk: float, guess: float, *, max_change: float = 1.0 / 3.0
) -> float:
    """Return the time-to-go (s) that gives a downrange jerk at the phase end.

    Downrange is along the horizontal velocity at the end. The guess is returned if this velocity is
    zero or Klumpp's cubic has no root near the guess.

    Parameters
    ----------
    estimate, end
        Estimated state, and end of the phase.
    jerk
        Downrange jerk at the end, m/s^3.
    guess
        Time-to-go of the previous cycle, s.
    max_change
        Maximum difference between a root and the guess, as a fraction of the guess; if it is
        larger, the guess is returned.
    """
    along = end.velocity[:2]
    speed = float(np.hypot(*along))
    if speed == 0.0:
        return guess
    unit = along / speed
    goal = float(unit @ end.position[:2]), speed, float(unit @ end.acceleration[:2])
    found = jerk_time_to_go(
        float(unit @ estimate.position[:2]), float(unit @ estimate.velocity[:2]), goal, jerk,
        guess=guess,
    )  # fmt: skip
    return found if abs(found - guess) < max_change * guess else guess
