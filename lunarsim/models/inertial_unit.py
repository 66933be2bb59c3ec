"""Error parameters of inertial units, shared by sensor and navigation filter."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.parts.quantity import check_bounds, quantity


@dataclass(frozen=True)
class TriadErrors:
    """Error model of three gyroscopes (u = rad) or accelerometers (u = m/s).

    Attributes
    ----------
    bias
        Bias at power-on, 1 sigma per axis, u/s.
    random_walk
        White noise of the rate, u/sqrt(s): angle or velocity random walk (N of an Allan plot).
    bias_walk
        Random walk of the bias, u/s per sqrt(s): rate random walk (K of an Allan plot).
    scale_factor
        Relative scale factor error, 1 sigma per axis.
    misalignment
        Misalignment of each axis towards each other axis, 1 sigma, rad.
    quantum
        Quantization step, u; 0: none. The remainder is carried to the next sample.
    """

    bias: float = quantity(
        0.0,
        ge=0,
        help="bias at power-on, 1 sigma per axis (gyroscopes: rad/s; accelerometers: m/s^2)",
    )
    random_walk: float = quantity(
        0.0,
        ge=0,
        help="white noise: angle random walk of gyroscopes (rad/sqrt(s)), velocity random walk of "
        "accelerometers (m/s/sqrt(s))",
    )
    bias_walk: float = quantity(
        0.0,
        ge=0,
        help="random walk of the bias (gyroscopes: rad/s per sqrt(s); accelerometers: m/s^2 per "
        "sqrt(s))",
    )
    scale_factor: float = quantity(0.0, ge=0, help="relative scale factor error, 1 sigma per axis")
    misalignment: float = quantity(
        0.0,
        ge=0,
        help="angle (rad, 1 sigma) by which each measurement axis is tilted towards either of the "
        "other two axes",
    )
    quantum: float = quantity(
        0.0,
        ge=0,
        help="quantization step of the increment in each sample (gyroscopes: angle, rad; "
        "accelerometers: velocity, m/s); 0: none",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "imu")


# Tactical-grade unit: 1 deg/h, 0.1 deg/sqrt(h), 100 ppm; 300 micro-g, 0.05 m/s/sqrt(h), 200 ppm.
TACTICAL_GYROSCOPES = TriadErrors(4.8e-6, 2.9e-5, 1e-7, 1e-4, 1e-4, 1e-6)
TACTICAL_ACCELEROMETERS = TriadErrors(2.9e-3, 8e-4, 1e-5, 2e-4, 1e-4, 1e-4)
