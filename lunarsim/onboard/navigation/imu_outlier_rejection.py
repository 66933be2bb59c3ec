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

from lunarsim.errors import InputError
from lunarsim.models.inertial_unit import TriadErrors
from lunarsim.models.lander import Lander
from lunarsim.typing import Array, BoolArray
from lunarsim.value_checks import check_elements, check_shape

# Maximum specific force and rate of any lander, m/s^2 and rad/s.
_MAX_FORCE_M_S2, _MAX_RATE_RAD_S = 500.0, 50.0
# Margin on the rates of change that follow from the specification of the lander.
_DYNAMICS_MARGIN = 1.25
# Maximum difference of two samples by noise, in standard deviations: with six axes at 100 Hz about
# one sample in 3 hours is rejected because of its noise.
_NOISE_SIGMAS = 6.0
# Number of samples in a row that must agree with each other to be accepted after a jump.
CONFIRMATION_COUNT = 3


@dataclass(frozen=True)
class ImuSampleLimits:
    """Limits of inertial samples from the lander's dynamics and the sensor noise.

    Attributes
    ----------
    max_change
        Maximum change of rate and specific force (6,) between samples, rad/s and m/s^2; infinite if
        the vehicle is unknown.
    max_noise
        Maximum additional change by noise (6,), rad/s and m/s^2.
    maximum
        Maximum rate and specific force (6,), rad/s and m/s^2.
    """

    max_change: Array
    max_noise: Array
    maximum: Array

    @classmethod
    def unknown(cls) -> ImuSampleLimits:
        """Return the limits for an unknown lander: absolute maxima, no limit of change."""
        maximum = np.repeat([_MAX_RATE_RAD_S, _MAX_FORCE_M_S2], 3)
        return cls(np.full(6, np.inf), np.zeros(6), maximum)

    @classmethod
    def of(
        cls,
        lander: Lander,
        step: float,
        gyroscopes: TriadErrors,
        accelerometers: TriadErrors,
        *,
        slew: float = 0.0,
    ) -> ImuSampleLimits:
        """Return the limits that follow from a lander's actuators and sensor noise.

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
            raise InputError("step", step, "must be positive and finite")
        if not 0.0 <= slew < np.inf:
            raise InputError("slew", slew, "must be 0 or more, and finite")
        rotation = (
            np.asarray(lander.torque_max) / np.asarray(lander.inertia_dry) * step + 2.0 * slew
        )
        acceleration = lander.thrust_max / lander.dry_mass
        response = 1.0 - np.exp(-step / lander.thrust_lag) if lander.thrust_lag > 0.0 else 1.0
        change = _DYNAMICS_MARGIN * np.concatenate((rotation, np.full(3, acceleration * response)))
        noise = np.repeat(
            [_max_noise_change(unit, step) for unit in (gyroscopes, accelerometers)], 3
        )
        maximum = np.repeat([_MAX_RATE_RAD_S, 2.0 * acceleration + noise[3]], 3)
        return cls(change, noise, np.minimum(maximum, cls.unknown().maximum))


def _max_noise_change(triad: TriadErrors, step: float) -> float:
    """Return the maximum difference of two samples by noise and quantisation.

    The unit is rad/s if `triad` are gyroscopes and m/s^2 if they are accelerometers. `step` is the
    time between samples, s.
    """
    return (
        _NOISE_SIGMAS * float(np.sqrt(2.0 / step)) * triad.random_walk + 2.0 * triad.quantum / step
    )


@dataclass(frozen=True)
class ScreenedSamples:
    """Result of the outlier rejection in a series of inertial samples.

    Attributes
    ----------
    is_missing
        Whether each sample is missing or rejected (n,).
    rejected
        Number of rejected samples.
    jump
        Confirmed jump of rate and specific force (6,) beyond the dynamics of the lander, rad/s and
        m/s^2; 0 for none.
    """

    is_missing: BoolArray
    rejected: int
    jump: Array


class ImuOutlierDetector:
    """Detects outliers in a stream of inertial samples.

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

    def __init__(self, limits: ImuSampleLimits, step: float) -> None:
        if not 0.0 < step < np.inf:
            raise InputError("step", step, "must be positive and finite")
        for name in ("max_change", "max_noise", "maximum"):
            limit = np.asarray(getattr(limits, name))
            check_shape(f"limits.{name}", limit, (6,))
            check_elements(f"limits.{name}", limit, limit >= 0.0, "must be 0 or more")
        self.limits = limits
        self._step = step
        # Last accepted sample and the number of steps since; last rejected sample and the number
        # of samples in a row that agree with it.
        self._last_accepted: Array | None = None
        self._steps_since_last = 0
        self._last_rejected = np.full(6, np.nan)
        self._agreeing = 0

    def screen(self, angle: Array, velocity: Array) -> ScreenedSamples:
        """Find missing and implausible samples in increments of angle and velocity.

        `angle` (n, 3), rad, and `velocity` (n, 3), m/s, follow the samples of the last call; NaN
        marks missing samples. A sample is rejected if its rate or specific force exceeds the
        absolute maximum, or differs from that of the last accepted sample by more than dynamics
        and noise of the lander allow. The third of three samples in a row that agree with each
        other is accepted as a jump.
        """
        samples = np.hstack((angle, velocity)) / self._step
        with np.errstate(invalid="ignore"):
            is_implausible = np.asarray((np.abs(samples) > self.limits.maximum).any(axis=1))
        is_present: BoolArray = np.asarray(np.isfinite(samples).all(axis=1) & ~is_implausible)
        rejected, jump = int(is_implausible.sum()), np.zeros(6)
        if not np.isfinite(self.limits.max_change).any():
            return ScreenedSamples(~is_present, rejected, jump)
        if self._last_accepted is None:
            if not is_present.any():
                return ScreenedSamples(~is_present, rejected, jump)
            # A spike among the first samples shows only in comparison with the others.
            self._last_accepted, self._steps_since_last = (
                np.median(samples[is_present], axis=0),
                len(samples),
            )
        if is_present.all() and self._accept_all(samples, self._last_accepted):
            return ScreenedSamples(~is_present, rejected, jump)
        is_missing = ~is_present
        for n in range(len(samples)):
            if not is_present[n]:
                self._steps_since_last += 1
                continue
            change = np.abs(samples[n] - self._last_accepted)
            is_accepted = (
                change
                <= self.limits.max_change * (1 + self._steps_since_last) + self.limits.max_noise
            ).all()
            if is_accepted or self._is_confirmed(samples[n]):
                if not is_accepted:
                    jump = np.maximum(jump, change)
                self._last_accepted, self._steps_since_last, self._agreeing = samples[n], 0, 0
            else:
                is_missing[n] = True
                rejected += 1
                self._steps_since_last += 1
        return ScreenedSamples(is_missing, rejected, jump)

    def _accept_all(self, samples: Array, last: Array) -> bool:
        """Accept all samples (n, 6) together if no change between them exceeds the limits.

        `last` (6,) is the last accepted sample. The return value states whether the samples were
        accepted; no sample may be missing.
        """
        if len(samples):
            change = np.abs(np.diff(samples, axis=0, prepend=last[None]))
            if (change > self.limits.max_change + self.limits.max_noise).any():
                return False
            self._last_accepted, self._steps_since_last, self._agreeing = samples[-1], 0, 0
        return True

    def _is_confirmed(self, sample: Array) -> bool:
        """Store an implausible sample (6,); return whether it confirms a jump.

        It does if it is the third in a row of implausible samples, each of which agrees with the
        one before.
        """
        agrees = (
            np.abs(sample - self._last_rejected) <= self.limits.max_change + self.limits.max_noise
        )
        self._agreeing = self._agreeing + 1 if self._agreeing and bool(agrees.all()) else 1
        self._last_rejected = sample
        return self._agreeing >= CONFIRMATION_COUNT
