"""What of the dispersions a metric hangs on, with errors; by SALib (extra `sensitivity`).

Sobol indices come from a Saltelli design alone (`method = "saltelli"`). From any other method's
flights PAWN is worked out (Pianosi and Wagener 2018): how far the distribution of the metric moves,
as a Kolmogorov distance, when a key is held in a tenth of its range; the median of ten tenths. Its
errors are bootstrapped, and a column drawn for nothing tells what chance alone gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray

from lunarsim.campaign.analysis import arm_rows, column
from lunarsim.campaign.outcomes import FLOWN
from lunarsim.campaign.results import Results
from lunarsim.errors import InputError, suggestion
from lunarsim.rng import design_seed
from lunarsim.scenario.changes import path_of

Array = NDArray[np.float64]
Interval = tuple[float, float, float]

# The factor of a Saltelli design that is no key: rocks, noise, navigation errors.
WORLD = "world and noise"
# Flights of an arm below which nothing is said, and rows that PAWN looks at at most.
_LEAST, _MOST = 50, 1000
_TENTHS = 10


@dataclass(frozen=True)
class Sensitivity:
    """Of one arm's metric.

    Attributes
    ----------
    arm, metric, method
        Of what; sobol or pawn.
    rows, left_out
        Flights that it is from, and those that could not be used.
    names
        Keys that were drawn; of Sobol indices the world as well.
    indices
        By name of the index ("first order", "total"; "PAWN"), a value with its 95 % interval for
        each of the names.
    chance
        PAWN's 95 % quantile of a column drawn for nothing; NaN for Sobol indices.
    why_not
        Why there are no indices; "" where there are.
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
    """Raise `InputError` that names the extra if SALib is not installed."""
    try:
        import SALib  # noqa: F401, PLC0415  (an extra)
    except ImportError:
        raise InputError(
            "sensitivity",
            "SALib",
            'a package that is installed: pip install "lunarsim[sensitivity]"',
        ) from None


def sensitivities(found: Results, metric: str = "safe", resamples: int = 100) -> list[Sensitivity]:
    """Return the sensitivity of a metric in every arm.

    Parameters
    ----------
    found
        A campaign with dispersions.
    metric
        Column of numbers, or of true and false.
    resamples
        Of the bootstrap.

    Raises
    ------
    InputError
        If SALib is not installed, the campaign draws nothing, its flights do not count alike, or
        the metric is no number.
    """
    found.check_even("folder")
    identity = found.manifest["identity"]
    keys = list(identity.get("dispersions", {}))
    if not keys:
        raise InputError("folder", str(found.folder), "a campaign with [dispersions]")
    known = [n for n, kind in found.manifest["columns"].items() if kind != "text"]
    if metric not in known:
        raise InputError("--metric", metric, suggestion(metric, known))
    check_installed()
    flown = pc.equal(found.table["outcome"], FLOWN).to_numpy(zero_copy_only=False)
    values = np.where(flown, column(found, metric), np.nan)
    seed = int(found.manifest["seed"])
    out = []
    for arm, rows in arm_rows(found).items():
        rng = np.random.default_rng(design_seed(seed))
        if identity.get("method") == "saltelli":
            flights = found.table["flight"].to_numpy()[rows]
            out.append(_sobol(arm, metric, keys, flights, values[rows], resamples, rng))
        else:
            inputs = np.column_stack([_input(found, key)[rows] for key in keys])
            out.append(_pawn(arm, metric, keys, inputs, values[rows], resamples, rng))
    return out


def _sobol(
    arm: str, metric: str, keys: Sequence[str], flights: NDArray[np.int64], values: Array,
    resamples: int, rng: np.random.Generator,
) -> Sensitivity:  # fmt: skip
    """Return Sobol indices of whole blocks; a block with a flight without a value is left out."""
    from SALib.analyze import sobol  # noqa: PLC0415

    names = (*keys, WORLD)
    block = len(keys) + 3
    blocks = np.full((int(flights.max(initial=-1)) // block + 1, block), np.nan)
    blocks[flights // block, flights % block] = values
    whole = blocks[np.isfinite(blocks).all(axis=1)]
    told = Sensitivity(
        arm, metric, "sobol", whole.size, len(values) - whole.size, names, {},
        why_not=_why_not(whole.ravel()),
    )  # fmt: skip
    if told.why_not:
        return told
    made = sobol.analyze(
        {"num_vars": len(names), "names": list(names)}, whole.ravel(), calc_second_order=False,
        num_resamples=resamples, seed=int(rng.integers(1, 2**31)),
    )  # fmt: skip
    indices = {
        label: [
            (float(v), float(v - e), float(v + e))
            for v, e in zip(made[name], made[f"{name}_conf"], strict=True)
        ]
        for label, name in (("first order", "S1"), ("total", "ST"))
    }
    return replace(told, indices=indices)


def _pawn(
    arm: str, metric: str, keys: Sequence[str], inputs: Array, values: Array, resamples: int,
    rng: np.random.Generator,
) -> Sensitivity:  # fmt: skip
    """Return PAWN's medians with percentiles of a bootstrap, and what chance alone gives."""
    good = np.isfinite(values) & np.isfinite(inputs).all(axis=1)
    inputs, y = inputs[good], values[good]
    told = Sensitivity(
        arm, metric, "pawn", len(y), len(values) - len(y), tuple(keys), {}, why_not=_why_not(y)
    )
    if told.why_not:
        return told
    if len(y) > _MOST:
        some = np.sort(rng.choice(len(y), _MOST, replace=False))
        inputs, y = inputs[some], y[some]
    inputs = _ranks(inputs, rng)
    value = _pawn_medians(inputs, y)
    drawn = np.empty((resamples, len(keys) + 1))
    for i in range(resamples):
        rows = rng.integers(len(y), size=len(y))
        nothing = rng.random(len(y))
        drawn[i] = _pawn_medians(np.column_stack((inputs[rows], nothing)), y[rows])
    # Fewer distinct flights make all distances greater: the spread is taken, not the place.
    spread = drawn[:, :-1] - drawn[:, :-1].mean(axis=0)
    low, high = value + np.quantile(spread, (0.025, 0.975), axis=0)
    intervals = [
        (float(v), max(float(a), 0.0), float(b)) for v, a, b in zip(value, low, high, strict=True)
    ]
    chance = float(np.quantile(drawn[:, -1], 0.95))
    return replace(told, indices={"PAWN": intervals}, chance=chance)


def _ranks(inputs: Array, rng: np.random.Generator) -> Array:
    """Return the ranks of each column (n, keys), equal values in an order that is drawn.

    Tenths are then tenths of the flights, also where a key has few values.
    """
    out = np.empty(inputs.shape)
    for column_of, values in zip(out.T, inputs.T, strict=True):
        column_of[np.lexsort((rng.random(len(values)), values))] = np.arange(len(values))
    return out


def _pawn_medians(inputs: Array, values: Array) -> Array:
    from SALib.analyze import pawn  # noqa: PLC0415

    names = [f"x{i}" for i in range(inputs.shape[1])]
    problem = {"num_vars": len(names), "names": names}
    return np.asarray(pawn.analyze(problem, inputs, values, S=_TENTHS)["median"])


def _why_not(values: Array) -> str:
    if len(values) < _LEAST:
        return f"{len(values)} flights can be used, fewer than {_LEAST}"
    return "" if np.ptp(values) > 0.0 else f"all flights have the value {values[0]:g}"


def _input(found: Results, key: str) -> Array:
    """Return the draws of a key as numbers: words by their order in the alphabet."""
    name = ".".join(path_of(key))
    if found.manifest["inputs"].get(name) != "text":
        return column(found, name)
    words = found.table[name].to_pylist()
    return np.array([sorted(set(words)).index(w) for w in words], dtype=np.float64)
