"""Reject inertial samples that exceed the dynamics of the lander.

A sample is compared with the last accepted one: from one to the next the angular rate changes by no
more than the thrusters can cause, and the specific force by no more than the engine can. Samples
beyond this limit plus the noise count as missing. If several such samples in a row agree with each
other, they are accepted, and the bias variances are increased by the jump. Either the unit or the
earlier samples are then wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.models.inertial_unit import TriadErrors
from lunarsim.models.lander import Lander

Array = NDArray[np.float64]

# Maximum specific force and rate of any lander, m/s^2 and rad/s.
_MOST_FORCE, _MOST_RATE = 500.0, 50.0
# Margin on the rates of change that follow from the specification of the lander.
_MARGIN = 1.25
# Maximum difference of two samples by noise, in standard deviations: with six axes at 100 Hz about
# one sample in 3 hours is rejected because of its noise.
_DEVIATIONS = 6.0
# Number of samples in a row that must agree with each other to be accepted after a jump.
CONFIRM = 3


@dataclass(frozen=True)
class SampleLimits:
    """Limits of the inertial samples from the lander's dynamics and the sensor noise.

    Attributes
    ----------
    step
        Maximum change of rate and specific force (6,) between samples, rad/s and m/s^2; infinite
        if the vehicle is unknown.
    noise
        Maximum additional change by noise (6,), rad/s and m/s^2.
    most
        Maximum rate and specific force (6,), rad/s and m/s^2.
    """

    step: Array
    noise: Array
    most: Array

    @classmethod
    def unknown(cls) -> SampleLimits:
        """Return the limits of an unknown lander."""
        most = np.repeat([_MOST_RATE, _MOST_FORCE], 3)
        return cls(np.full(6, np.inf), np.zeros(6), most)

    @classmethod
    def of(
        cls,
        lander: Lander,
        step: float,
        gyroscopes: TriadErrors,
        accelerometers: TriadErrors,
        *,
        slew: float = 0.0,
    ) -> SampleLimits:
        """Return the limits of a given lander.

        Parameters
        ----------
        lander
            Specification of the lander.
        step
            Time between samples, s.
        gyroscopes, accelerometers
            Error models of the inertial unit.
        slew
            Rate that an ideal attitude actuator can reach instantly, rad/s; 0 for thrusters.

        Raises
        ------
        InputError
            If the step is not positive, the rate is negative, or either is not finite.
        """
        if not 0.0 < step < np.inf:
            raise InputError("step", step, "must be a positive time in seconds")
        if not 0.0 <= slew < np.inf:
            raise InputError("slew", slew, "must be a non-negative rate in rad/s")
        turn = np.asarray(lander.torque_max) / np.asarray(lander.inertia_dry) * step + 2.0 * slew
        push = lander.thrust_max / lander.dry_mass
        follows = 1.0 - np.exp(-step / lander.thrust_lag) if lander.thrust_lag > 0.0 else 1.0
        change = _MARGIN * np.concatenate((turn, np.full(3, push * follows)))
        noise = np.repeat([_noise(unit, step) for unit in (gyroscopes, accelerometers)], 3)
        most = np.repeat([_MOST_RATE, 2.0 * push + noise[3]], 3)
        return cls(change, noise, np.minimum(most, cls.unknown().most))


def _noise(unit: TriadErrors, step: float) -> float:
    """Return the maximum difference of two samples by noise and quantisation, units/s."""
    return _DEVIATIONS * float(np.sqrt(2.0 / step)) * unit.random_walk + 2.0 * unit.quantum / step


@dataclass(frozen=True)
class Judged:
    """Result of the outlier rejection.

    Attributes
    ----------
    gone
        Whether each sample is missing or rejected (n,).
    refused
        Number of rejected samples.
    jump
        Confirmed jump of rate and specific force (6,) beyond the dynamics of the lander, rad/s and
        m/s^2; 0 for none.
    """

    gone: NDArray[np.bool_]
    refused: int
    jump: Array


class SampleGuard:
    """Detect outliers in a stream of inertial samples.

    Parameters
    ----------
    limits
        Limits of the lander's dynamics.
    step
        Time between samples, s.

    Raises
    ------
    InputError
        If a limit is NaN or negative, or the step is not positive.
    """

    def __init__(self, limits: SampleLimits, step: float) -> None:
        if not 0.0 < step < np.inf:
            raise InputError("step", step, "must be a positive time in seconds")
        for name in ("step", "noise", "most"):
            limit = np.asarray(getattr(limits, name))
            if limit.shape != (6,) or not (limit >= 0.0).all():
                raise InputError(f"limits.{name}", limit, "must be six non-negative numbers")
        self.limits = limits
        self._step = step
        # Last accepted sample and the number of steps since; last rejected sample and the number
        # of samples in a row that agree with it.
        self._last: Array | None = None
        self._away = 0
        self._other = np.full(6, np.nan)
        self._alike = 0

    def judge(self, angle: Array, velocity: Array) -> Judged:
        """Check increments (n, 3) and (n, 3), rad and m/s; NaN marks missing samples."""
        given = np.hstack((angle, velocity)) / self._step
        with np.errstate(invalid="ignore"):
            wild = np.asarray((np.abs(given) > self.limits.most).any(axis=1))
        here: NDArray[np.bool_] = np.asarray(np.isfinite(given).all(axis=1) & ~wild)
        refused, jump = int(wild.sum()), np.zeros(6)
        if not np.isfinite(self.limits.step).any():
            return Judged(~here, refused, jump)
        if self._last is None:
            if not here.any():
                return Judged(~here, refused, jump)
            # A spike among the first samples shows only in comparison with the others.
            self._last, self._away = np.median(given[here], axis=0), len(given)
        if here.all() and self._plain(given, self._last):
            return Judged(~here, refused, jump)
        gone = ~here
        for n in range(len(given)):
            if not here[n]:
                self._away += 1
                continue
            change = np.abs(given[n] - self._last)
            believed = (change <= self.limits.step * (1 + self._away) + self.limits.noise).all()
            if believed or self._confirmed(given[n]):
                if not believed:
                    jump = np.maximum(jump, change)
                self._last, self._away, self._alike = given[n], 0, 0
            else:
                gone[n] = True
                refused += 1
                self._away += 1
        return Judged(gone, refused, jump)

    def _plain(self, given: Array, last: Array) -> bool:
        """Accept samples at once if none is missing and none differs much from the last."""
        if len(given):
            change = np.abs(np.diff(given, axis=0, prepend=last[None]))
            if (change > self.limits.step + self.limits.noise).any():
                return False
            self._last, self._away, self._alike = given[-1], 0, 0
        return True

    def _confirmed(self, sample: Array) -> bool:
        """Return whether enough rejected samples in a row agree with this one."""
        agrees = np.abs(sample - self._other) <= self.limits.step + self.limits.noise
        self._alike = self._alike + 1 if self._alike and bool(agrees.all()) else 1
        self._other = sample
        return self._alike >= CONFIRM
