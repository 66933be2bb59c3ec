"""Error figures of inertial measurement units, known to the unit and to what navigates by it."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.parts.quantity import check_bounds, quantity


@dataclass(frozen=True)
class TriadErrors:
    """Error model of one triad; u is rad for gyroscopes and m/s for accelerometers.

    Attributes
    ----------
    bias
        Of one power-on, 1 sigma an axis, u/s.
    random_walk
        White noise on the rate, u/sqrt(s): angle or velocity random walk, N of an Allan plot.
    bias_walk
        Random walk of the bias, u/s per sqrt(s): rate random walk, K of an Allan plot.
    scale_factor
        Relative, 1 sigma an axis.
    misalignment
        Of each axis towards each of the others, 1 sigma, rad.
    quantum
        Least increment, u; 0: none. What is not yet a whole quantum is kept for the next sample.
    """

    bias: float = quantity(0.0, ge=0, help="of one power-on, 1 sigma, u/s")
    random_walk: float = quantity(0.0, ge=0, help="white noise, u/sqrt(s)")
    bias_walk: float = quantity(0.0, ge=0, help="walk of the bias, u/s per sqrt(s)")
    scale_factor: float = quantity(0.0, ge=0, help="1 sigma")
    misalignment: float = quantity(0.0, ge=0, help="of each axis towards each other, rad, 1 sigma")
    quantum: float = quantity(0.0, ge=0, help="smallest increment, u")

    def __post_init__(self) -> None:
        check_bounds(self, "imu")


# A tactical unit: 1 deg/h, 0.1 deg/sqrt(h), 100 ppm; 300 micro-g, 0.05 m/s/sqrt(h), 200 ppm.
GYROSCOPES = TriadErrors(4.8e-6, 2.9e-5, 1e-7, 1e-4, 1e-4, 1e-6)
ACCELEROMETERS = TriadErrors(2.9e-3, 8e-4, 1e-5, 2e-4, 1e-4, 1e-4)
