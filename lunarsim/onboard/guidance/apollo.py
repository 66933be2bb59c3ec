"""The Apollo polynomial law (Klumpp, "Apollo lunar descent guidance", Automatica 10, 1974).

The two-point boundary value problem of position and velocity now, and position, velocity and
acceleration at the target a time-to-go T later, has one solution with an acceleration quadratic
in time. It is solved afresh every cycle, which closes the loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import APOLLO, PathShape
from lunarsim.onboard.navigation.estimate import Estimate


@dataclass(frozen=True)
class ApolloLaw(PathLaw):
    """The Apollo polynomial law (Klumpp 1974)."""

    @property
    def shape(self) -> PathShape:
        """Linear and quadratic in the time that is left."""
        return APOLLO


def jerk_time_to_go(
    position: float,
    velocity: float,
    end: tuple[float, float, float],
    jerk: float,
    *,
    guess: float,
) -> float:
    """Return the time-to-go (s) whose quartic ends with a given jerk along one axis.

    The root of ``J T^3 - 6 A T^2 + (18 V_f + 6 V) T - 24 (R_f - R) = 0`` that is nearest to the
    guess (Klumpp's cubic, which counts T negative); NaN if no root is positive.

    Parameters
    ----------
    position, velocity
        Downrange now, m and m/s.
    end
        Downrange position, velocity and acceleration at the target, m, m/s, m/s^2.
    jerk
        Downrange at the target, m/s^3.
    guess
        Time-to-go of the last cycle, s.

    Raises
    ------
    InputError
        If something is not finite.
    """
    r_f, v_f, a_f = end
    c = np.array([jerk, -6.0 * a_f, 18.0 * v_f + 6.0 * velocity, -24.0 * (r_f - position)])
    if not (np.isfinite(c).all() and np.isfinite(guess)):
        raise InputError("guidance.time_to_go", (c.tolist(), guess), "finite figures")
    roots = np.roots(c)
    real = roots.real[np.abs(roots.imag) <= 1e-9 * np.maximum(1.0, np.abs(roots))]
    real = real[real > 0.0]
    return float(real[np.argmin(np.abs(real - guess))]) if real.size else float("nan")


def followed_time(
    estimate: Estimate, end: PhaseEnd, jerk: float, guess: float, *, share: float = 1.0 / 3.0
) -> float:
    """Return the time-to-go (s) of a jerk wanted downrange at an end, or the guess itself.

    Downrange is along the end's velocity over ground. Where that is nought, or the cubic has no
    root within a share of the guess, the guess stays.

    Parameters
    ----------
    estimate, end
        Where the lander is, and where the phase ends.
    jerk
        Downrange at the end, m/s^3.
    guess
        Time-to-go of the last cycle, s.
    share
        Of the guess, by which the time-to-go may differ from it.
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
    return found if abs(found - guess) < share * guess else guess
