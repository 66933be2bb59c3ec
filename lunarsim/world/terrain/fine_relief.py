"""Roughness below the posts of procedural relief."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.world.terrain.heightfield import Heightfield

# Side of the square after which the roughness comes back, m, and most posts along it.
_TILE, _MOST_POSTS = 48.0, 1536


def add_fine_roughness(
    relief: Heightfield,
    posting: float,
    rng: np.random.Generator,
    *,
    hurst: float,
    rms_slope: float,
    baseline: float = 1.0,
) -> Heightfield:
    """Return fractal relief at finer posts, with the wavelengths that its own cannot show.

    Between the posts lies the spline through them; on it comes relief of the same law with no
    wavelength of more than twice the old posting. It comes back after some 48 m: what repeats is
    a few centimetres high, and lies on ground that does not.

    Parameters
    ----------
    relief
        Ground by `fractal_relief`.
    posting
        Of the finer posts, at most that of the relief, m; taken so that it divides the old one.
    rng, hurst, rms_slope, baseline
        As for `fractal_relief`.
    """
    if not 0.0 < posting <= relief.grid.posting:
        raise InputError("terrain.detail", posting, f"above 0, up to {relief.grid.posting:g} m")
    fine = relief.refined(posting)
    step = fine.grid.posting
    factor = round(relief.grid.posting / step)
    side = min(round(_TILE / step), _MOST_POSTS) // factor * factor
    if side * step < 2.0 * baseline:
        raise InputError("terrain.detail", posting, f"posts that reach {2.0 * baseline:g} m")
    tile = _short_waves(side, step, relief.grid.posting, rng, hurst, rms_slope, baseline)
    rows, cols = fine.grid.shape
    added = tile[np.arange(rows)[:, None] % side, np.arange(cols)[None, :] % side]
    return Heightfield(fine.grid, (fine.z + added).astype(np.float32))


def _short_waves(
    side: int,
    step: float,
    old: float,
    rng: np.random.Generator,
    hurst: float,
    rms_slope: float,
    baseline: float,
) -> NDArray[np.float64]:
    """Return periodic fractal relief (side, side) without waves longer than twice `old`, m.

    With them its slope at the baseline would be that given.
    """
    k = np.hypot(np.fft.rfftfreq(side, step)[None, :], np.fft.fftfreq(side, step)[:, None])
    k[0, 0] = np.inf
    noise = rng.standard_normal(k.shape) + 1j * rng.standard_normal(k.shape)
    waves = noise * k ** -(1.0 + hurst)
    whole = np.fft.irfft2(waves, s=(side, side))
    lag = max(1, round(baseline / step))
    steps = [np.roll(whole, -lag, axis) - whole for axis in (0, 1)]
    slope = np.sqrt(sum(float(np.mean(d**2)) for d in steps)) / (lag * step)
    short = np.fft.irfft2(np.where(k > 0.5 / old, waves, 0.0), s=(side, side))
    return np.asarray(short * np.tan(rms_slope) / slope)
