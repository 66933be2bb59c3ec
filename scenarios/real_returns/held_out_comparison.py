"""Compare heights and safety of the LiDAR maps with the held-out returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from returns import (
    SCAN_SPACING,
    SHIPPED,
    SIGMA,
    AirborneCloud,
    fit_prior,
    one_step_dem,
    quadtree_map,
    scaled_lander,
    slope_class,
    smoothed_slope,
    stepwise_dem,
    subtract_local_planes,
)
from scipy import ndimage

from lunarsim import Grid, exact_safety
from lunarsim.api import Lander
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.onboard.hazards.gaussian_dem import GaussianDem
from lunarsim.onboard.hazards.quadtree import SITE_STATUS, QuadtreeMapper
from lunarsim.onboard.hazards.quadtree.mapper import rasterize_cells
from lunarsim.safety import plane_stochastic_safety, stochastic_safety

POSTING = 0.25  # posting of the maps in the height test, m
STRIDE = 5  # spacing of the safety test sites in cells: neighbours are correlated
_SUMS = ("square_error", "called", "called_safe", "high", "high_safe")
ELIGIBLE = SITE_STATUS.index("eligible")
MIN_RETURNS = 4  # minimum number of mapped and of held-out returns in an evaluated quadtree cell


@dataclass(frozen=True)
class HeightErrors:
    """Height errors of a map at the held-out LiDAR returns.

    Attributes
    ----------
    error
        Mapped minus measured height (n,), m.
    sigma
        Predicted standard deviation of the error, including return noise (n,), m.
    stratum
        Slope class of the terrain: index into `STRATA` (n,).
    xy
        Position (n, 2), m.
    """

    error: np.ndarray
    sigma: np.ndarray
    stratum: np.ndarray
    xy: np.ndarray

    def statistics(self, slope_class: int | None = None) -> dict[str, float]:
        """Return count, bias, RMSE, NEES and outlier fractions of the errors.

        NEES is the mean squared ratio of error to sigma; the fractions are those beyond 2 and 3
        sigma. `slope_class` is an index into `STRATA`; None: all classes.
        """
        use = slice(None) if slope_class is None else self.stratum == slope_class
        error, ratio = self.error[use], self.error[use] / self.sigma[use]
        if not error.size:
            return dict.fromkeys(("bias", "rmse", "nees", "beyond2", "beyond3"), np.nan) | {"n": 0}
        return {
            "n": int(error.size),
            "bias": float(error.mean()),
            "rmse": float(np.sqrt(np.mean(error**2))),
            "nees": float(np.mean(ratio**2)),
            "beyond2": float((np.abs(ratio) > 2.0).mean()),
            "beyond3": float((np.abs(ratio) > 3.0).mean()),
        }


def interpolate_raster(raster: np.ndarray, grid: Grid, xy: np.ndarray) -> np.ndarray:
    """Interpolate a raster bilinearly at positions (n, 2); return values (n,).

    A value is NaN next to unknown cells.
    """
    place = ((xy[:, 1] - grid.y0) / grid.posting, (xy[:, 0] - grid.x0) / grid.posting)
    return np.asarray(
        ndimage.map_coordinates(raster.astype(np.float64), place, order=1, cval=np.nan)
    )


def dem_errors(dem: GaussianDem, held_out: np.ndarray, slope: np.ndarray) -> HeightErrors:
    """Return the height errors of a Gaussian DEM at held-out LiDAR returns.

    `held_out` (n, 3) are the returns, m; `slope` is the terrain slope on the DEM grid (rows, cols),
    deg. Returns where the DEM or the slope is unknown are omitted.
    """
    seen = np.where(dem.observed, dem.mean, np.nan)
    mean = interpolate_raster(seen, dem.grid, held_out[:, :2])
    variance = interpolate_raster(
        np.where(dem.observed, dem.variance, np.nan), dem.grid, held_out[:, :2]
    )
    row, col = dem.grid.cell(held_out[:, :2])
    inside = dem.grid.contains(held_out[:, :2])
    where = np.full(len(held_out), -1)
    where[inside] = slope_class(slope[row[inside], col[inside]])
    use = np.isfinite(mean) & np.isfinite(variance) & (where >= 0)
    sigma = np.sqrt(variance[use] + SIGMA**2)
    return HeightErrors(mean[use] - held_out[use, 2], sigma, where[use], held_out[use, :2])


def quadtree_errors(
    mapper: QuadtreeMapper, held_out: np.ndarray, slope: np.ndarray, grid: Grid
) -> HeightErrors:
    """Return the height errors of quadtree cells from the held-out returns in them.

    `held_out` (n, 3) are the returns, m; `slope` is the terrain slope on `grid` (rows, cols), deg.
    The error of a cell is its mean height minus the mean of the held-out returns; the predicted
    sigma is that of this difference, from the variance in the cell. Cells with fewer than
    `MIN_RETURNS` mapped or held-out returns are omitted.
    """
    tree = mapper.map
    nodes = tree.band(*mapper.selector.settings.site_band)
    xy, side = tree.centres(nodes), tree.sizes(nodes)
    count, mean, square = np.zeros((3, len(nodes)))
    for size in np.unique(side):
        mine = np.flatnonzero(side == size)
        corner = xy[mine].min(axis=0) - 0.5 * size
        place = {
            tuple(k): n for n, k in zip(mine, cell_indices(xy[mine], corner, size), strict=True)
        }
        for key, z in zip(cell_indices(held_out, corner, size), held_out[:, 2], strict=True):
            n = place.get(tuple(key))
            if n is not None:
                count[n] += 1
                mean[n] += z
                square[n] += z * z
    number = tree.point_counts(nodes)
    use = (count >= MIN_RETURNS) & (number >= MIN_RETURNS)
    count, number = count[use], number[use]
    mean = mean[use] / count
    squares = number * tree.variance(nodes)[use] + square[use] - count * mean**2
    inner = squares / (number + count - 2)
    sigma = np.sqrt(inner * (1.0 / number + 1.0 / count))
    row, col = grid.cell(xy[use])
    where = slope_class(slope[np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)])
    good = (sigma > 0.0) & (where >= 0)
    error = tree.elevation(nodes)[use] - mean
    return HeightErrors(error[good], sigma[good], where[good], xy[use][good])


def cell_indices(xy: np.ndarray, corner: np.ndarray, size: float) -> np.ndarray:
    """Return column and row (n, 2) of points in a raster of squares.

    `corner` is the south-west corner of the raster and `size` the side of a square, m.
    """
    return np.floor((xy[:, :2] - corner) / size).astype(np.int64)


def compare_heights(cloud: AirborneCloud, seed: int) -> dict[str, HeightErrors]:
    """Map a random half of the LiDAR returns by each method; test on the other half.

    Returns the height errors by name of the method.
    """
    rng = np.random.default_rng([seed, 0])
    mapped, held = cloud.split(0.5, rng)
    grid = cloud.grid(POSTING)
    slope = smoothed_slope(cloud, grid)
    own = fit_prior(subtract_local_planes(mapped), rng)
    apart = cloud.spacing(0.5)
    out = {
        "field of Table 6": dem_errors(one_step_dem(mapped, grid, SHIPPED), held, slope),
        "fitted": dem_errors(one_step_dem(mapped, grid, fit_prior(mapped, rng)), held, slope),
        "fitted without trend": dem_errors(one_step_dem(mapped, grid, own), held, slope),
        "as flights do": dem_errors(stepwise_dem(mapped, grid, apart, 1), held, slope),
        "as flights do, 4 parts": dem_errors(stepwise_dem(mapped, grid, apart, 4), held, slope),
    }
    factor = cloud.spacing(0.5) / SCAN_SPACING
    mapper = quadtree_map(mapped, grid, factor, 1.0 / cloud.spacing(0.5) ** 2)
    out["quadtree cells"] = quadtree_errors(mapper, held, slope, grid)
    return out


@dataclass(frozen=True)
class SafetyComparison:
    """Safety of sites according to the maps and to the held-out LiDAR returns.

    Attributes
    ----------
    p
        p_safe (n,) by method; NaN where a method has too few data.
    safe, stratum
        Exact safety on the held-out returns (n,); slope class as index into `STRATA` (n,).
    agreement
        Fraction of sites for which mapped and held-out returns give the same exact safety.
    dense_share, held_share
        Fraction of sites exactly safe on all returns, and on the held-out returns.
    scale
        Scale of the lander relative to the default one.
    maps
        Truth and probabilities by method as rasters, evaluated cells, and their grid.
    """

    p: dict[str, np.ndarray]
    safe: np.ndarray
    stratum: np.ndarray
    agreement: float
    dense_share: float
    held_share: float
    scale: float
    maps: Any = None


def compare_safety(cloud: AirborneCloud, mapped_fraction: float, seed: int) -> SafetyComparison:
    """Map a fraction of the LiDAR returns; test p_safe on the other returns.

    The lander is scaled with the spacing of the mapped returns.
    """
    rng = np.random.default_rng([seed, 1])
    mapped, held = cloud.split(mapped_fraction, rng)
    factor = cloud.spacing(mapped_fraction) / SCAN_SPACING
    lander = scaled_lander(Lander(), factor)
    grid = cloud.grid(0.1 * factor)
    own = fit_prior(subtract_local_planes(mapped), rng)
    # All lengths scale, including the amplitude and the correlation length of the field.
    shipped = {name: factor * value for name, value in SHIPPED.items()}
    held_out = exact_safety_of_returns(held, grid, lander, own)
    use = held_out.observed.copy()
    rasters = {}
    for form, test, name, setting in (
        ("Eqs. 15-17", stochastic_safety, "field of Table 6", shipped),
        ("planes", plane_stochastic_safety, "field of Table 6", shipped),
        ("planes", plane_stochastic_safety, "fitted", own),
    ):
        dem = one_step_dem(mapped, grid, setting)
        seen = np.where(dem.observed, dem.mean, np.float32(np.nan))
        safety = test(seen, dem.variance, grid, lander)
        use &= safety.observed
        rasters[f"{form}, {name}"] = safety.p_safe
    again = exact_safety_of_returns(mapped, grid, lander, own)
    dense = exact_safety_of_returns(cloud.points, grid, lander, own)
    use &= again.observed & dense.observed
    use &= (np.arange(grid.rows) % STRIDE == 0)[:, None] & (np.arange(grid.cols) % STRIDE == 0)
    mapper = quadtree_map(mapped, grid, factor, 1.0 / cloud.spacing(mapped_fraction) ** 2)
    tree, sites = mapper.hazard_map(), mapper.select()
    size = mapper.map.sizes(sites.nodes)
    eligible = rasterize_cells(grid, sites.position[:, :2], size, sites.status == ELIGIBLE, np.nan)
    rasters["quadtree"] = np.where(tree.observed, tree.p_safe, np.float32(np.nan))
    rasters["quadtree, eligible"] = np.where(tree.observed, eligible, np.nan)
    p = {name: raster[use] for name, raster in rasters.items()}
    return SafetyComparison(
        p,
        held_out.safe[use],
        slope_class(smoothed_slope(cloud, grid))[use],
        float((again.safe == held_out.safe)[use].mean()),
        float(dense.safe[use].mean()),
        float(held_out.safe[use].mean()),
        factor,
        (np.where(held_out.observed, held_out.safe, np.nan), rasters, use, grid),
    )


def exact_safety_of_returns(
    points: np.ndarray, grid: Grid, lander: Lander, prior: dict[str, float]
) -> Any:
    """Return the exact safety of the surface interpolated through LiDAR returns.

    `points` (n, 3) are the returns, m; `prior` holds `sigma_f` and `length_scale` of the Gaussian
    DEM (m).
    """
    dem = one_step_dem(points, grid, prior)
    return exact_safety(np.where(dem.observed, dem.mean, np.nan), grid, lander)


def safety_counts(p: np.ndarray, safe: np.ndarray) -> dict[str, Any]:
    """Count the true safety of sites (n,) by p_safe; counts of several splits can be added.

    "table" is the reliability table; "called" counts sites with p > 0.5 and "high" sites with
    p > 0.95. Sites without p_safe (NaN) are omitted.
    """
    known = np.isfinite(p)
    p, safe = p[known], safe[known]
    called, high = p > 0.5, p > 0.95
    return {
        "table": reliability(p, safe).tolist(),
        "square_error": float(((p - safe.astype(np.float64)) ** 2).sum()),
        "called": int(called.sum()), "called_safe": int((called & safe).sum()),
        "high": int(high.sum()), "high_safe": int((high & safe).sum()),
    }  # fmt: skip


def safety_metrics(counts: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return quality metrics of p_safe, pooled over several values of `safety_counts`.

    They are count, safe fraction, mean p, calibration error (ECE), Brier skill, precision and
    recall at p > 0.5, and safe fraction at p > 0.95.
    """
    table = np.sum([c["table"] for c in counts], axis=0)
    total = {name: sum(c[name] for c in counts) for name in counts[0] if name in _SUMS}
    n, p_sum, safe = (float(v) for v in table.sum(axis=0))
    base = _ratio(safe, n)
    return {
        "n": int(n), "share": base, "mean_p": _ratio(p_sum, n), "ece": calibration_error(table),
        "skill": 1.0 - _ratio(_ratio(total["square_error"], n), base * (1.0 - base)),
        "precision": _ratio(total["called_safe"], total["called"]),
        "recall": _ratio(total["called_safe"], safe),
        "above": _ratio(total["high_safe"], total["high"]),
    }  # fmt: skip


def _ratio(part: float, total: float) -> float:
    """Return a ratio; NaN if the total is zero."""
    return part / total if total else float("nan")


def height_metrics(statistics: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Pool several values of `HeightErrors.statistics`, weighted by the number of returns."""
    full = [s for s in statistics if s["n"]]
    total = sum(s["n"] for s in full)
    mean = {
        name: sum(s["n"] * s[name] ** power for s in full) / total if total else float("nan")
        for name, power in (("bias", 1), ("rmse", 2), ("nees", 1), ("beyond2", 1), ("beyond3", 1))
    }
    return {"n": total, **mean, "rmse": float(np.sqrt(mean["rmse"]))}
