"""Procedural relief: fractal terrain by spectral synthesis."""

from __future__ import annotations

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.world.terrain.heightfield import Heightfield


def fractal_relief(
    grid: Grid,
    rng: np.random.Generator,
    *,
    hurst: float,
    rms_slope: float,
    baseline: float = 1.0,
) -> Heightfield:
    """Generate random self-affine (fractal) relief with a given roughness.

    The two-dimensional power spectrum falls as ``k**-(2 + 2 hurst)``, as observed for planetary
    surfaces. The synthesis covers twice the width of the grid, so that opposite edges are
    uncorrelated. The result is scaled so that the root mean square slope between points `baseline`
    apart (east and north together) is `rms_slope`.

    Parameters
    ----------
    grid
        Grid of the relief.
    rng
        Source of the phases and amplitudes.
    hurst
        Hurst exponent in (0, 1): 0.9 is smooth rolling terrain, 0.5 is rough.
    rms_slope
        Root mean square slope at the baseline, rad.
    baseline
        Length over which the slope is measured, m; at least one grid spacing.

    Returns
    -------
    Heightfield
        Relief with zero mean.
    """
    if not 0.0 < hurst < 1.0:
        raise InputError("terrain.hurst", hurst, "must be between 0 and 1")
    if not 0.0 <= rms_slope < np.pi / 4:
        raise InputError(
            "terrain.rms_slope", float(np.rad2deg(rms_slope)),
            "must be 0 or more and less than 45 degrees",
        )  # fmt: skip
    rows, cols = 2 * grid.rows, 2 * grid.cols
    ky = np.fft.fftfreq(rows, grid.posting)[:, None]
    kx = np.fft.rfftfreq(cols, grid.posting)[None, :]
    k = np.hypot(kx, ky)
    k[0, 0] = np.inf
    noise = rng.standard_normal(k.shape) + 1j * rng.standard_normal(k.shape)
    z = np.fft.irfft2(noise * k ** -(1.0 + hurst), s=(rows, cols))[: grid.rows, : grid.cols]
    step = max(1, round(baseline / grid.posting))
    if min(grid.shape) <= step:
        side = min(grid.shape) * grid.posting
        raise InputError(
            "terrain.size_m",
            side,
            f"must be more than {baseline:g} m, the length over which the slope is measured",
        )
    length = step * grid.posting
    mean_square = np.mean(((z[:, step:] - z[:, :-step]) / length) ** 2) + np.mean(
        ((z[step:, :] - z[:-step, :]) / length) ** 2
    )
    z *= np.tan(rms_slope) / np.sqrt(mean_square)
    return Heightfield(grid, (z - z.mean()).astype(np.float32))


def add_detail(measured: Heightfield, detail: Heightfield) -> Heightfield:
    """Refine measured relief and add synthetic detail between its grid points.

    The spline through the detail's values at the measured points is subtracted from the detail.
    The measured points therefore keep their elevations.

    Parameters
    ----------
    measured
        Relief at the grid spacing of the measurement.
    detail
        Synthetic relief on the refined grid, that of ``measured.refined(...)``.

    Returns
    -------
    Heightfield
        Relief on the refined grid.

    Raises
    ------
    InputError
        If the grids do not match.
    """
    fine = measured.refined(detail.grid.posting)
    if fine.grid != detail.grid:
        raise InputError(
            "terrain.detail", detail.grid, "must have the grid of `measured.refined`",
            show_value=False,
        )  # fmt: skip
    factor = round(measured.grid.posting / fine.grid.posting)
    coarse = Heightfield(measured.grid, detail.z[::factor, ::factor])
    added = detail.z.astype(np.float64) - coarse.refined(detail.grid.posting).z
    return Heightfield(fine.grid, (fine.z + added).astype(np.float32))
