"""Whether inertial samples are such as the lander can make.

A sample is judged by the last that was believed: from one to the next a lander's rate changes by no
more than its thrusters can turn it, and its specific force by no more than the engine follows. What
lies beyond that and the noise counts as missing. Where several such samples in a row agree with
each other it is no spike: they are believed, and the biases are let go by as much, since either the
unit or what was believed before is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.models.inertial_unit import TriadErrors
from lunarsim.models.lander import Lander

Array = NDArray[np.float64]

# No lander pushes or turns like this, m/s^2 and rad/s.
_MOST_FORCE, _MOST_RATE = 500.0, 50.0
# The vehicle may do so much better than its figures say.
_MARGIN = 1.25
# Deviations of the difference of two samples' noise that are still believed: of six axes at 100 Hz
# one sample in 3 hours is refused for its noise alone.
_DEVIATIONS = 6.0
# So many samples in a row that agree with each other, and not with what came before, are believed.
CONFIRM = 3


@dataclass(frozen=True)
class SampleLimits:
    """What a lander can do, and what its inertial unit's noise adds.

    Attributes
    ----------
    step
        By which a sample may differ from the one before, rate and specific force (6,), rad/s and
        m/s^2; infinite where nothing is known of the vehicle.
    noise
        By which noise may make them differ besides (6,).
    most
        Greatest rate and specific force (6,).
    """

    step: Array
    noise: Array
    most: Array

    @classmethod
    def unknown(cls) -> SampleLimits:
        """Return those of any lander."""
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
        """Return those of a lander.

        Parameters
        ----------
        lander
            Its figures.
        step
            Between samples, s.
        gyroscopes, accelerometers
            Error models of the unit.
        slew
            Rate that an ideal attitude actuator may take at once, rad/s; 0: thrusters turn it.

        Raises
        ------
        InputError
            If the step is not positive, or the rate negative, or either not finite.
        """
        if not 0.0 < step < np.inf:
            raise InputError("step", step, "a positive time in seconds")
        if not 0.0 <= slew < np.inf:
            raise InputError("slew", slew, "a rate of at least 0 rad/s")
        turn = np.asarray(lander.torque_max) / np.asarray(lander.inertia_dry) * step + 2.0 * slew
        push = lander.thrust_max / lander.dry_mass
        follows = 1.0 - np.exp(-step / lander.thrust_lag) if lander.thrust_lag > 0.0 else 1.0
        change = _MARGIN * np.concatenate((turn, np.full(3, push * follows)))
        noise = np.repeat([_noise(unit, step) for unit in (gyroscopes, accelerometers)], 3)
        most = np.repeat([_MOST_RATE, 2.0 * push + noise[3]], 3)
        return cls(change, noise, np.minimum(most, cls.unknown().most))


def _noise(unit: TriadErrors, step: float) -> float:
    """Return by how much noise makes two samples' rates differ at most, units/s."""
    return _DEVIATIONS * float(np.sqrt(2.0 / step)) * unit.random_walk + 2.0 * unit.quantum / step


@dataclass(frozen=True)
class Judged:
    """What came of samples.

    Attributes
    ----------
    gone
        Which are missing, or count as missing (n,).
    refused
        How many there were that are not believed.
    jump
        By how much rate and specific force (6,) jumped in a way that no lander can, where samples
        after it agree; 0 for none.
    """

    gone: NDArray[np.bool_]
    refused: int
    jump: Array


class SampleGuard:
    """Judges inertial samples as they come.

    Parameters
    ----------
    limits
        What the lander can do.
    step
        Between samples, s.

    Raises
    ------
    InputError
        If a limit is NaN or negative, or the step not positive.
    """

    def __init__(self, limits: SampleLimits, step: float) -> None:
        if not 0.0 < step < np.inf:
            raise InputError("step", step, "a positive time in seconds")
        for name in ("step", "noise", "most"):
            limit = np.asarray(getattr(limits, name))
            if limit.shape != (6,) or not (limit >= 0.0).all():
                raise InputError(f"limits.{name}", limit, "six numbers of at least 0")
        self.limits = limits
        self._step = step
        # The last sample believed, and how many steps ago; the last that was not, and how many in a
        # row agree with it.
        self._last: Array | None = None
        self._away = 0
        self._other = np.full(6, np.nan)
        self._alike = 0

    def judge(self, angle: Array, velocity: Array) -> Judged:
        """Judge increments (n, 3), (n, 3), rad and m/s, NaN for missing ones."""
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
            # Which of the first ones is a spike only the others can tell.
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
        """Take in samples that are all there, if none differs much from the one before."""
        if len(given):
            change = np.abs(np.diff(given, axis=0, prepend=last[None]))
            if (change > self.limits.step + self.limits.noise).any():
                return False
            self._last, self._away, self._alike = given[-1], 0, 0
        return True

    def _confirmed(self, sample: Array) -> bool:
        """Tell whether enough samples in a row agree with this one."""
        agrees = np.abs(sample - self._other) <= self.limits.step + self.limits.noise
        self._alike = self._alike + 1 if self._alike and bool(agrees.all()) else 1
        self._other = sample
        return self._alike >= CONFIRM
