"""Reference for p_safe: posterior probability of safety, by simulation.

Elevations of a patch have a known prior: fractal relief and hemispherical rocks at random places
with a given size distribution. Given the returns of a scan, a Markov chain draws patches from the
posterior, and the exact safety test is applied to each. The safe fraction is the probability that
no calibration can improve, for this prior, these returns and one site. It is slow: a second to a
minute per site.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lunarsim.errors import InputError
from lunarsim.evaluation import _patch_kernels as k
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.rocks.field import RockField
from lunarsim.rocks.size_distribution import golombek_exponent, golombek_number
from lunarsim.typing import Array, IntArray
from lunarsim.world.site_safety import site_safety
from lunarsim.world.terrain import Heightfield, Terrain

# Standard deviation of the mean elevation of a patch, relative to the median of the returns, m.
_MEAN_SIGMA_M = 10.0
# Standard deviation of independent errors of the relief, m; keeps its covariance regular.
_JITTER_M = 1e-4
# Minimum standard deviation of the returns at the start of a chain, and of drawn patches, m.
_FIRST_SIGMA_M, _LAST_SIGMA_M = 0.5, 1e-3
_DIAMETERS = 4096  # entries of the table of diameters


@dataclass(frozen=True)
class PatchPrior:
    """Prior of the terrain around a site: fractal relief and hemispherical rocks.

    Attributes
    ----------
    cover
        Fraction of terrain covered by rocks of all sizes (Golombek's k); 0: no rocks.
    min_diameter, max_diameter
        Limits of the diameters of rocks, m.
    rms_slope
        Root mean square slope of the relief between points 1 m apart, rad.
    hurst
        Hurst exponent of the relief.
    posting
        Distance between the grid points of the relief, m.
    terrain_size
        Side of the terrain of which the patch is a part, m.
    """

    cover: float = 0.05
    min_diameter: float = 0.15
    max_diameter: float = 3.0
    rms_slope: float = 0.0
    hurst: float = 0.85
    posting: float = 0.5
    terrain_size: float = 100.0

    def __post_init__(self) -> None:
        for name in ("min_diameter", "posting"):
            if not getattr(self, name) > 0.0:
                raise InputError(name, getattr(self, name), "must be positive")
        if not self.min_diameter < self.max_diameter:
            raise InputError("max_diameter", self.max_diameter, "must exceed min_diameter")
        if not 0.0 <= self.cover <= 0.5:
            raise InputError("cover", self.cover, "must be from 0 to 0.5")

    def rock_density(self) -> float:
        """Return the mean number of rocks per square metre."""
        if self.cover == 0.0:
            return 0.0
        number = golombek_number([self.min_diameter, self.max_diameter], self.cover)
        return float(number[0] - number[1])

    def diameters(self) -> Array:
        """Return the diameters (n,), m, at equal steps of their distribution function."""
        d = np.geomspace(self.min_diameter, self.max_diameter, _DIAMETERS)
        if self.cover == 0.0:
            return d
        number = golombek_number(d, self.cover)
        below = (number[0] - number) / (number[0] - number[-1])
        share = np.linspace(0.0, 1.0, _DIAMETERS)
        return np.asarray(np.exp(np.interp(share, below, np.log(d))))

    def relief_covariance(self, grid: Grid) -> Array:
        """Return the covariance of the elevations of grid points (n, n), m^2.

        The relief is that of `lunarsim.world.terrain.fractal_relief` on a terrain of the size
        `terrain_size`; its spectrum gives the covariance. The mean elevation is unknown.
        """
        n = 2 * max(round(self.terrain_size / self.posting) + 1, *grid.shape)
        f = np.fft.fftfreq(n, self.posting)
        frequency = np.hypot(f[:, None], f[None, : n // 2 + 1])
        frequency[0, 0] = np.inf
        shape = np.fft.irfft2(frequency ** -(2.0 + 2.0 * self.hurst), s=(n, n))
        step = max(1, round(1.0 / self.posting))
        length = step * self.posting
        mean_square = (4.0 * shape[0, 0] - 2.0 * shape[0, step] - 2.0 * shape[step, 0]) / length**2
        shape *= np.tan(self.rms_slope) ** 2 / mean_square
        i, j = (index.ravel() for index in np.indices(grid.shape))
        away = np.abs(i[:, None] - i), np.abs(j[:, None] - j)
        return np.asarray(shape[away] + _MEAN_SIGMA_M**2 + _JITTER_M**2 * np.eye(i.size))


@dataclass(frozen=True)
class PosteriorSafety:
    """Posterior probability that a site is safe.

    Attributes
    ----------
    p_safe
        Safe fraction of the drawn patches.
    effective_samples
        Number of independent draws with the same variance of this fraction; NaN if all patches
        are safe, or none.
    chains
        Safe fraction of each chain (n,).
    """

    p_safe: float
    effective_samples: float
    chains: Array


def posterior_safety(
    points: ArrayLike,
    sigma: ArrayLike,
    prior: PatchPrior,
    lander: Lander,
    rng: np.random.Generator,
    *,
    chains: int = 4,
    samples: int = 50,
    moves: int = 5000,
    cooling: int = 60,
) -> PosteriorSafety:
    """Return the posterior probability that a lander at the origin is safe.

    It must be safe for all headings.

    Parameters
    ----------
    points
        Returns around the site (n, 3), m, ENU, with the site at x = y = 0.
    sigma
        Standard deviation of their height (n,), m.
    prior
        Prior of the terrain.
    lander
        Geometry and limits of the lander.
    rng
        Source of the chains' random numbers.
    chains, samples
        Number of independent chains, and of patches drawn by each.
    moves
        Moves of the rocks between two patches.
    cooling
        Steps in which the noise of the returns is reduced to its value, before patches are drawn.
    """
    safe = np.array([
        [is_safe(relief, rocks, lander) for relief, rocks in
         draw_patches(points, sigma, prior, half_side(prior, lander), rng, samples, moves, cooling)]
        for _ in range(chains)
    ])  # fmt: skip
    return PosteriorSafety(float(safe.mean()), effective_samples(safe), safe.mean(axis=1))


def half_side(prior: PatchPrior, lander: Lander) -> float:
    """Return half the side of the patch that the safety of a site depends on, m.

    Rocks up to 1 m in radius that reach under the lander have their centres on it.
    """
    reach = lander.leg_radius + 0.5 * lander.pad_diameter
    return reach + min(0.5 * prior.max_diameter, 1.0)


def is_safe(relief: Heightfield, rocks: RockField, lander: Lander) -> bool:
    """Return whether a lander at the origin is safe by the exact test."""
    site = Grid.centred((0.0, 0.0), 0.2, 0.2)
    safe, observed = site_safety(Terrain(relief, rocks), site, lander)
    return bool((safe & observed)[0, 0])


def draw_patches(
    points: ArrayLike,
    sigma: ArrayLike,
    prior: PatchPrior,
    half: float,
    rng: np.random.Generator,
    samples: int,
    moves: int,
    cooling: int,
) -> list[tuple[Heightfield, RockField]]:
    """Return patches of terrain from the posterior, by one Markov chain.

    Elevations are relative to the median of the returns.

    The rocks move with the relief fixed (`move_rocks`). The relief is then drawn from its Gaussian
    distribution given the rocks and the returns that are on the terrain or on each rock. A draw
    that changes this assignment is rejected. `half` is half the side of the patch, m; the other
    parameters are those of `posterior_safety`.
    """
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    inside = np.isfinite(cloud).all(axis=1) & (np.abs(cloud[:, :2]) < half).all(axis=1)
    noise = np.broadcast_to(np.asarray(sigma, dtype=np.float64), len(cloud))[inside]
    cloud = np.ascontiguousarray(cloud[inside])
    if len(cloud):
        cloud[:, 2] -= np.median(cloud[:, 2])
    grid = Grid.centred((0.0, 0.0), 2.0 * half + 2.0 * prior.posting, prior.posting)
    frame = (grid.x0, grid.y0, grid.posting)
    precision = linalg.inv(prior.relief_covariance(grid))
    buckets, law = _buckets(cloud, half), (
        prior.rock_density(), golombek_exponent(prior.cover) if prior.cover else 0.0,
        prior.min_diameter, prior.max_diameter, np.log(prior.diameters()),
    )  # fmt: skip
    rocks, count = np.zeros((k.MAX_ROCKS, 4)), 0
    owner, expected, terrain = np.full(len(cloud), -1), *np.zeros((2, len(cloud)))
    relief = np.zeros(grid.shape)
    patches = []
    for step in range(cooling + samples):
        cooled = _LAST_SIGMA_M / _FIRST_SIGMA_M
        minimum = _FIRST_SIGMA_M * cooled ** min(step / max(cooling, 1), 1.0)
        weight = 1.0 / np.maximum(noise, minimum) ** 2
        drawn = _draw_relief(cloud, weight, owner, rocks, grid, precision, rng)
        k.fill_relief(cloud, drawn, frame, terrain)
        raised = rocks.copy()
        k.fill_relief(rocks[:count], drawn, frame, raised[:count, 3])
        new_owner, new_expected = owner.copy(), expected.copy()
        k.assign_returns(cloud, terrain, raised, count, new_owner, new_expected)
        # While the noise is reduced, the chain need not be exact.
        if step < cooling or np.array_equal(new_owner, owner):
            relief, rocks, expected = drawn, raised, new_expected
        k.fill_relief(cloud, relief, frame, terrain)
        if law[0] > 0.0:
            count = k.move_rocks(
                cloud, weight, terrain, expected, buckets, relief, frame, rocks, count, law, half,
                moves, int(rng.integers(2**32)),
            )  # fmt: skip
        k.assign_returns(cloud, terrain, rocks, count, owner, expected)
        if step >= cooling:
            x, y, radius, base = rocks[:count].T
            elevation = relief.astype(np.float32)
            patches.append(
                (Heightfield(grid, elevation), RockField.hemispheres(x, y, base, radius))
            )
    return patches


def _draw_relief(
    cloud: Array,
    weight: Array,
    owner: Array,
    rocks: Array,
    grid: Grid,
    precision: Array,
    rng: np.random.Generator,
) -> Array:
    """Draw the relief (rows, cols), m, given the returns and their rocks.

    `cloud` (n, 3) are the returns, `owner` (n,) the rock of each. `weight` (n,) are inverse
    variances, and `precision` is the inverse covariance of the prior.
    """
    frame = (grid.x0, grid.y0, grid.posting)
    total, pull = precision.copy(), np.zeros(len(precision))
    k.add_returns(cloud, weight, rocks, owner, frame, grid.cols, total, pull)
    factor = linalg.cholesky(total, lower=True, overwrite_a=True)
    mean = linalg.cho_solve((factor, True), pull)
    noise = linalg.solve_triangular(factor, rng.standard_normal(len(mean)), lower=True, trans=1)
    return np.asarray((mean + noise).reshape(grid.shape))


def _buckets(cloud: Array, half: float) -> tuple[IntArray, IntArray, float, float, int]:
    """Return the buckets of returns.

    They are the first return of each, the order of the returns, the origin, and their number per
    side.
    """
    side = int(np.ceil(2.0 * half / k.BUCKET_M))
    cell = np.floor((cloud[:, :2] + half) / k.BUCKET_M).astype(np.int64)
    index = np.clip(cell[:, 1], 0, side - 1) * side + np.clip(cell[:, 0], 0, side - 1)
    start = np.searchsorted(np.sort(index), np.arange(side * side + 1))
    order = np.argsort(index, kind="stable")
    return start.astype(np.int64), order.astype(np.int64), -half, -half, side


def effective_samples(values: ArrayLike) -> float:
    """Return the effective number of samples of chains (chains, samples).

    It follows from the autocorrelations and from the variance between chains (Gelman et al.,
    Bayesian Data Analysis, section 11.5). It is NaN if all values are equal.
    """
    x = np.asarray(values, dtype=np.float64)
    m, n = x.shape
    within = x.var(axis=1, ddof=1).mean()
    between = n * x.mean(axis=1).var(ddof=1) if m > 1 else 0.0
    total = (n - 1) / n * within + between / n
    if total == 0.0:
        return float("nan")
    sum_of_correlations, previous = 0.0, 0.0
    for lag in range(1, n):
        variogram = ((x[:, lag:] - x[:, :-lag]) ** 2).mean()
        correlation = 1.0 - variogram / (2.0 * total)
        if lag % 2 == 0 and correlation + previous < 0.0:
            break
        sum_of_correlations += correlation
        previous = correlation
    return float(min(m * n, m * n / max(1.0 + 2.0 * sum_of_correlations, 1e-9)))
