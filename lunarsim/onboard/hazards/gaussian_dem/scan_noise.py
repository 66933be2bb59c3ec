"""Range noise of a scan, estimated from its returns.

White noise adds the same variance to range differences at any distance between pixels; terrain adds
more variance over larger distances. The height differences of a random walk, which the Gaussian DEM
assumes, have twice the variance over twice the distance, and smoother terrain has more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from lunarsim.messages.measurements import LidarScan

# Quantile of the absolute differences that gives the estimate: the smoothest tenth of the scan.
_QUANTILE = 0.1
# Largest ratio of estimated to stated noise that rocks explain. Rocks between the pixels look like
# noise. With the maximum expected cover, 0.2, half (0.8^3) of the triples of pixels hit none; the
# quantile of all triples is then at most twice that of triples without rocks.
_MAX_RATIO_OF_ROCKS = 2.0
# Minimum number of differences: five standard errors of the ratio, 6.7 / sqrt(n), are then 1.
_MIN_DIFFERENCES = 1100


def with_estimated_noise(scan: LidarScan) -> LidarScan:
    """Return a scan that states its estimated noise if that is clearly larger.

    The stated standard deviations are multiplied by the result of `noise_ratio` if it exceeds 2.
    Smaller ratios may be the effect of rocks between the pixels.
    """
    ratio = noise_ratio(scan)
    return replace(scan, sigma=ratio * scan.sigma) if ratio > _MAX_RATIO_OF_ROCKS else scan


def noise_ratio(scan: LidarScan) -> float:
    """Return a lower estimate of the noise over the stated noise; NaN if unknown.

    The differences between a range and the mean of two others at one or two pixels in its row are
    compared: twice the variance at one pixel minus the variance at two contains the noise, and no
    terrain that is at least as smooth as a random walk. At least 1100 differences are needed.
    """
    ranges = scan.range.reshape(scan.shape)
    own, sigma = ranges[:, 2:-2], scan.sigma.reshape(scan.shape)[:, 2:-2]
    variances = []
    for lag in (1, 2):
        ends = ranges[:, 2 - lag : -2 - lag] + np.roll(ranges, -lag, axis=1)[:, 2:-2]
        difference = np.abs(own - 0.5 * ends) / sigma
        known = difference[np.isfinite(difference)]
        if len(known) < _MIN_DIFFERENCES:
            return float("nan")
        variances.append(float(np.quantile(known, _QUANTILE)) ** 2 / 1.5)
    one_sigma = float(ndtri(0.5 + 0.5 * _QUANTILE))
    return float(np.sqrt(max(2.0 * variances[0] - variances[1], 0.0))) / one_sigma
