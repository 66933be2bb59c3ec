"""Guidance laws with two powers of time-to-go in the acceleration.

E-guidance: Cherry, "A general, explicit, optimizing guidance law for rocket-propelled spaceflight",
AIAA paper 64-638, 1964. It meets position and velocity at the target with an acceleration linear in
time, which is free at the target. Under uniform gravity and a fixed time-to-go it minimises the
integral of the squared thrust acceleration.

Fractional polynomials: Lu, "Theory of fractional-polynomial powered descent guidance", Journal of
Guidance, Control, and Dynamics 43(3), 2020. Two parameters shape the path, from E-guidance to laws
that approach their final acceleration early. `gamma` is one power of time-to-go; the gain
``k_r >= 2 (gamma + 2)`` gives the other power, ``k_r / (gamma + 2) - 2``. With gamma = 1, k_r = 12
gives the Apollo law and k_r = 6 gives E-guidance. This case is augmented Apollo guidance: Lu,
"Augmented Apollo powered descent guidance", JGCD 42(3), 2019.

ZEM/ZEV feedback: Ebrahimi, Bahrami and Roshanian, "Optimal sliding-mode guidance with terminal
velocity constraint for fixed-interval propulsive maneuvers", Acta Astronautica 62, 2008; Guo,
Hawkins and Wie, "Applications of generalized zero-effort-miss/zero-effort-velocity feedback
guidance algorithm", JGCD 36(3), 2013. The predicted miss and velocity error without thrust are fed
back with the gains of minimum control effort; under uniform gravity this is E-guidance.

Modified Apollo law: Klumpp's paths with limits on jerk and snap. The quadtree paper ranks sites by
their delta-v at the minimum time-to-go within these limits (its Eq. 10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.core.feedback import fractional_polynomial, zem_zev
from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert_cost import DivertCost, PathLimits, divert_cost
from lunarsim.onboard.guidance.jerk_limited import min_times_to_go
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import E_GUIDANCE, PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array


@dataclass(frozen=True)
class EGuidanceLaw(PathLaw):
    """Settings of the E-guidance law (Cherry 1964): acceleration linear in time.

    The law itself is the `PathGuidance` that `build` returns for one flight.
    """

    @property
    def shape(self) -> PathShape:
        """Shape of the paths: acceleration with constant and linear terms of time-to-go."""
        return E_GUIDANCE


def fractional_shape(gamma: float, gain: float) -> PathShape:
    """Return the path shape with powers `gamma` and ``gain / (gamma + 2) - 2``.

    The powers may come in either order. Equal powers need a logarithm and are rejected.

    Raises
    ------
    InputError
        If gamma is negative, or the gain is too small or makes the powers equal.
    """
    min_gain = 2.0 * (gamma + 2.0)
    if not 0.0 <= gamma < np.inf:
        raise InputError("guidance.gamma", gamma, "must be 0 or more, and finite")
    if not min_gain <= gain < np.inf:
        raise InputError(
            "guidance.gain", gain, f"must be finite and at least {min_gain:g} if gamma is {gamma:g}"
        )
    other = gain / (gamma + 2.0) - 2.0
    if abs(other - gamma) < 1e-6:
        raise InputError(
            "guidance.gain", gain,
            f"must not be {(gamma + 2.0) ** 2:g} if gamma is {gamma:g}",
            "Otherwise the two powers of the path are equal.",
        )  # fmt: skip
    return PathShape(min(gamma, other), max(gamma, other))


@dataclass(frozen=True)
class FractionalPolynomialLaw(PathLaw):
    """Settings of fractional-polynomial powered descent guidance (Lu 2020).

    Attributes
    ----------
    gamma
        One of the two powers of time-to-go in the acceleration.
    gain
        Gain k_r of the position error, which gives the other power.
    """

    gamma: float = quantity(
        0.5, ge=0, le=10, help="one of the two exponents of time-to-go in the acceleration"
    )
    gain: float = quantity(
        8.0,
        gt=0,
        le=200,
        help="feedback gain k_r of the position error, at least 2 (gamma + 2); the second exponent "
        "of time-to-go in the acceleration is k_r / (gamma + 2) - 2",
    )

    formula = staticmethod(fractional_polynomial)

    def __post_init__(self) -> None:
        try:
            fractional_shape(self.gamma, self.gain)
        except InputError as error:
            raise error.with_field(error.field.rpartition(".")[2]) from None

    @property
    def shape(self) -> PathShape:
        """Shape of the paths that a vehicle without lag flies."""
        return fractional_shape(self.gamma, self.gain)

    @property
    def gains(self) -> tuple[float, ...]:
        """Parameters gamma and k_r of the feedback formula."""
        return self.gamma, self.gain


@dataclass(frozen=True)
class AugmentedApolloLaw(FractionalPolynomialLaw):
    """Settings of augmented Apollo guidance (Lu 2019).

    This is the fractional-polynomial law with gamma = 1.

    Attributes
    ----------
    gamma
        Fixed at 1.
    gain
        Gain k_r of the position error: 6 gives E-guidance, 12 the Apollo law.
    """

    gamma: float = quantity(
        1.0,
        ge=1,
        le=1,
        help="exponent of time-to-go in the acceleration; 1 is the only value of this law",
    )
    gain: float = quantity(
        8.0,
        ge=6,
        le=200,
        help="feedback gain k_r of the position error; 6 gives E-guidance, 12 gives the Apollo law",
    )


@dataclass(frozen=True)
class ZemZevLaw(PathLaw):
    """Settings of zero-effort-miss/zero-effort-velocity feedback (Guo 2013).

    The law is also in Ebrahimi 2008.
    """

    formula = staticmethod(zem_zev)

    @property
    def shape(self) -> PathShape:
        """Shape of the paths: that of E-guidance, to which the law is equal without lag."""
        return E_GUIDANCE


@dataclass(frozen=True)
class ModifiedApolloLaw(ApolloLaw):
    """Settings of the Apollo law with limits on jerk and snap of its paths.

    Attributes
    ----------
    jerk, snap
        Maximum jerk, m/s^3, and snap, m/s^4, which define a minimum time-to-go.
    """

    jerk: float = quantity(0.25, "m/s^3", gt=0, help="maximum jerk along the path")
    snap: float = quantity(
        0.05, "m/s^4", gt=0, help="maximum snap (time derivative of jerk) along the path"
    )

    def cost(
        self,
        estimate: Estimate,
        end: PhaseEnd,
        lander: Lander,
        gravity: float,
        limits: PathLimits | None = None,
        times: Array | None = None,
    ) -> DivertCost:
        """Return the propellant cost of reaching each of n ends of an approach.

        Time-to-go is the optimal admissible one above the minimum from the limits of jerk and snap;
        `times` (n,), s, replaces it. `limits` are those of thrust, tilt, glideslope and propellant.
        """
        min_times = min_times_to_go(
            estimate.position, estimate.velocity, end, jerk=self.jerk, snap=self.snap
        )
        return divert_cost(
            estimate, end, lander, gravity, limits=limits, shape=self.shape, min_times=min_times,
            times=times,
        )  # fmt: skip
