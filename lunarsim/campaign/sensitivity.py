"""Compute sensitivity indices of a metric with intervals, by SALib.

SALib is in the extra `sensitivity`.

Sobol indices need a Saltelli design (`method = "saltelli"`). For other methods PAWN is computed
(Pianosi and Wagener 2018): the Kolmogorov distance between the distribution of the metric and its
distribution with a key limited to a tenth of its range; the median over ten tenths. Its intervals
are bootstrapped. A random dummy column shows the value that chance alone gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow.compute as pc

from lunarsim.campaign.analysis import arm_rows, column
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.results import Results
from lunarsim.errors import InputError, missing_package, suggestion
from lunarsim.rng import design_seed
from lunarsim.scenario.changes import path_of
from lunarsim.typing import Array, IntArray

Interval = tuple[float, float, float]

# Additional factor of a Saltelli design: rocks, noise, navigation errors.
WORLD_FACTOR = "world and noise"
# Minimum number of flights of an arm, and maximum number of rows for PAWN.
_MIN_FLIGHTS, _MAX_PAWN_ROWS = 50, 1000
_PAWN_BINS = 10


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity of a metric to the random scenario values, in one arm.

    An arm is a variant of the scenario.

    Attributes
    ----------
    arm, metric, method
        Name of the arm; name of the metric; sobol or pawn.
    rows, left_out
        Number of flights used, and of flights that could not be used.
    names
        Dispersed keys; for Sobol indices also the world.
    indices
        By name of the index ("first order", "total"; "PAWN"): a value with its 95 % interval for
        each of the names.
    chance
        95th percentile of PAWN for a dummy column; NaN for Sobol indices.
    why_not
        Reason why there are no indices; "" if there are.
    """

    arm: str
    metric: str
    method: str
    rows: int
    left_out: int
    names: tuple[str, ...]
    indices: dict[str, list[Interval]]
    chance: float = float("nan")
    why_not: str = ""


def check_installed() -> None:
    """Raise `InputError` with the command to install SALib if it is not installed."""
    try:
        import SALib  # noqa: F401, PLC0415  (an extra)
    except ImportError:
        raise missing_package("sensitivity", "SALib", "sensitivity") from None


def sensitivities(
    results: Results, metric: str = "safe", resamples: int = 100
) -> list[Sensitivity]:
    """Compute the sensitivity of a metric to the dispersed values, in every arm.

    An arm is a variant of the scenario.

    Parameters
    ----------
    results
        Results of a campaign with dispersions.
    metric
        Numeric or boolean column.
    resamples
        Number of bootstrap resamples.

    Raises
    ------
    InputError
        If SALib is not installed, the campaign has no dispersions, flights have unequal weights,
        or the metric is not numeric.
    """
    results.check_equal_weights("folder")
    identity = results.manifest["identity"]
    keys = list(identity.get("dispersions", {}))
    if not keys:
        raise InputError("folder", str(results.folder), "must be a campaign with [dispersions]")
    known = [n for n, kind in results.manifest["columns"].items() if kind != "text"]
    if metric not in known:
        raise InputError(
            "--metric", metric, "must be a numeric or boolean column of the results",
            suggestion(metric, known),
        )  # fmt: skip
    check_installed()
    flown = pc.equal(results.table["outcome"], FLOWN).to_numpy(zero_copy_only=False)
    values = np.where(flown, column(results, metric), np.nan)
    seed = int(results.manifest["seed"])
    out = []
    for arm, rows in arm_rows(results).items():
        rng = np.random.default_rng(design_seed(seed))
        if identity.get("method") == "saltelli":
            flights = results.table["flight"].to_numpy()[rows]
            out.append(_sobol(arm, metric, keys, flights, values[rows], resamples, rng))
        else:
            inputs = np.column_stack([_input(results, key)[rows] for key in keys])
            out.append(_pawn(arm, metric, keys, inputs, values[rows], resamples, rng))
    return out


def _sobol(
    arm: str, metric: str, keys: Sequence[str], flights: IntArray, values: Array,
    resamples: int, rng: np.random.Generator,
) -> Sensitivity:  # fmt: skip
    """Compute Sobol indices of one arm from the complete blocks of a Saltelli design.

    An arm is a variant of the scenario. `flights` and `values` (n,) are flight indices and metric;
    `keys` are the dispersed keys.
    """
    from SALib.analyze import sobol  # noqa: PLC0415

    names = (*keys, WORLD_FACTOR)
    block = len(keys) + 3
    blocks = np.full((int(flights.max(initial=-1)) // block + 1, block), np.nan)
    blocks[flights // block, flights % block] = values
    complete = blocks[np.isfinite(blocks).all(axis=1)]
    result = Sensitivity(
        arm, metric, "sobol", complete.size, len(values) - complete.size, names, {},
        why_not=_reason_without_indices(complete.ravel()),
    )  # fmt: skip
    if result.why_not:
        return result
    made = sobol.analyze(
        {"num_vars": len(names), "names": list(names)}, complete.ravel(), calc_second_order=False,
        num_resamples=resamples, seed=int(rng.integers(1, 2**31)),
    )  # fmt: skip
    indices = {
        label: [
            (float(v), float(v - e), float(v + e))
            for v, e in zip(made[name], made[f"{name}_conf"], strict=True)
        ]
        for label, name in (("first order", "S1"), ("total", "ST"))
    }
    return replace(result, indices=indices)


def _pawn(
    arm: str, metric: str, keys: Sequence[str], inputs: Array, values: Array, resamples: int,
    rng: np.random.Generator,
) -> Sensitivity:  # fmt: skip
    """Compute PAWN indices of one arm, bootstrap intervals, and the value by chance.

    An arm is a variant of the scenario. `inputs` (n, keys) are the dispersed values, and `values`
    (n,) the metric of each flight.
    """
    good = np.isfinite(values) & np.isfinite(inputs).all(axis=1)
    inputs, y = inputs[good], values[good]
    result = Sensitivity(
        arm,
        metric,
        "pawn",
        len(y),
        len(values) - len(y),
        tuple(keys),
        {},
        why_not=_reason_without_indices(y),
    )
    if result.why_not:
        return result
    if len(y) > _MAX_PAWN_ROWS:
        some = np.sort(rng.choice(len(y), _MAX_PAWN_ROWS, replace=False))
        inputs, y = inputs[some], y[some]
    inputs = _ranks(inputs, rng)
    value = _pawn_medians(inputs, y)
    drawn = np.empty((resamples, len(keys) + 1))
    for i in range(resamples):
        rows = rng.integers(len(y), size=len(y))
        nothing = rng.random(len(y))
        drawn[i] = _pawn_medians(np.column_stack((inputs[rows], nothing)), y[rows])
    # Resamples have fewer distinct flights, which biases the distances: use only their spread.
    spread = drawn[:, :-1] - drawn[:, :-1].mean(axis=0)
    low, high = value + np.quantile(spread, (0.025, 0.975), axis=0)
    intervals = [
        (float(v), max(float(a), 0.0), float(b)) for v, a, b in zip(value, low, high, strict=True)
    ]
    chance = float(np.quantile(drawn[:, -1], 0.95))
    return replace(result, indices={"PAWN": intervals}, chance=chance)


def _ranks(inputs: Array, rng: np.random.Generator) -> Array:
    """Return the ranks of the values in each column of `inputs` (n, keys).

    Ties have random order.

    Tenths then contain equal numbers of flights, also for keys with few values.
    """
    out = np.empty(inputs.shape)
    for column_of, values in zip(out.T, inputs.T, strict=True):
        column_of[np.lexsort((rng.random(len(values)), values))] = np.arange(len(values))
    return out


def _pawn_medians(inputs: Array, values: Array) -> Array:
    from SALib.analyze import pawn  # noqa: PLC0415

    names = [f"x{i}" for i in range(inputs.shape[1])]
    problem = {"num_vars": len(names), "names": names}
    return np.asarray(pawn.analyze(problem, inputs, values, S=_PAWN_BINS)["median"])


def _reason_without_indices(values: Array) -> str:
    if len(values) < _MIN_FLIGHTS:
        return f"only {len(values)} flights can be used, fewer than {_MIN_FLIGHTS}"
    return "" if np.ptp(values) > 0.0 else f"all flights have the value {values[0]:g}"


def _input(results: Results, key: str) -> Array:
    """Return the random values of a scenario key as numbers (n,).

    Strings become their alphabetical rank.
    """
    name = ".".join(path_of(key))
    if results.manifest["inputs"].get(name) != "text":
        return column(results, name)
    words = results.table[name].to_pylist()
    return np.array([sorted(set(words)).index(w) for w in words], dtype=np.float64)
