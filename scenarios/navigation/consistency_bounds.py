"""Compare navigation errors and innovations of flights with the bounds of a consistent filter.

The functions take the rows of the study `consistency.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from lunarsim.evaluation.consistency import Consistency, normalised_squared_error

Row = dict[str, Any]
EPOCHS = (0.15, 0.35, 0.55, 0.75, 0.95)
PARTS = {"all nine": np.arange(9), "position": np.r_[0:3], "velocity": np.r_[3:6],
         "attitude": np.r_[6:9]}  # fmt: skip
LEVEL = 0.999
# Scenarios of the long check: lower limit of NEES as a fraction of its bound, and changed keys. In
# morpheus NEES is lower, because a map post that is used again counts less and scans are assumed to
# differ by more than they do on horizontal grass. The keys give the terrain knowledge of the
# mission, so that a horizontal plane is not modelled as relief.
HORIZONTAL_TERRAIN = (
    "navigation.terrain_slope_deg=0.5",
    "initial_uncertainty.target_elevation_m=5",
)
SETS = {
    "instruments": (1.0, ()),
    "camera_and_lidar": (1.0, HORIZONTAL_TERRAIN),
    "shadow_nominal": (1.0, HORIZONTAL_TERRAIN),
    "morpheus": (0.5, ()),
}
# Innovations may be smaller than their covariance, by kind: a rock appears at the same wrong
# position in successive images while the view changes little, and reused maps correlate scans and
# fits.
MIN_NIS_FACTOR = {"places": 0.4, "scans": 0.2, "map": 0.0}
# They may also be larger: rocks with a radius of one pixel scatter by more than the model.
MAX_NIS_FACTOR = {"places": 1.7}
# Maximum error in standard deviations of a flight that is not declared lost; maximum fraction of
# lost flights.
MAX_ERROR_SIGMA, MAX_LOST_FRACTION = 5.0, 0.02


def nees_of(flights: Sequence[Row], epoch: int, components: np.ndarray) -> Consistency:
    """Return the NEES of selected state errors at an epoch, summed over the flights.

    NEES is the normalised estimation error squared. `epoch` is an index of `EPOCHS`; `components`
    holds the indices of the selected errors among position, velocity and attitude (9). Flights that
    ended before the epoch are omitted.
    """
    found = Consistency()
    for f in flights:
        if len(f["error"]) > epoch:
            error, covariance = np.array(f["error"][epoch]), np.array(f["covariance"][epoch])
            own = covariance[np.ix_(components, components)]
            found = found.plus(normalised_squared_error(error[components], own), len(components))
    return found


def nis_of(sums: Iterable[Mapping[str, Sequence[Any]]], kind: str) -> Consistency:
    """Return the NIS of a kind of measurement, summed over flights.

    NIS is the normalised innovation squared. `sums` holds, for each flight, the sum of NIS and its
    degrees of freedom by kind.
    """
    found = [one[kind] for one in sums if kind in one]
    return Consistency(sum(total for total, _ in found), sum(degrees for _, degrees in found))


def nees_table(flights: Sequence[Row]) -> Table:
    """Return the table of NEES per degree of freedom by epoch and part of the state.

    NEES is the normalised estimation error squared.
    """
    table = Table(title=f"NEES / degrees of freedom [{100 * LEVEL:g} % bounds]; !: outside")
    table.add_column("fraction of the descent", justify="right")
    for part in PARTS:
        table.add_column(part, justify="right")
    for k, share in enumerate(EPOCHS):
        cells = []
        for keep in PARTS.values():
            found = nees_of(flights, k, keep)
            low, high = found.bounds(LEVEL)
            mark = "" if found.holds(LEVEL) else " !"
            cells.append(f"{found.ratio:.2f} [{low:.2f}, {high:.2f}]{mark}")
        table.add_row(f"{share:.2f}", *cells)
    return table


def nis_table(flights: Sequence[Row], column: str, title: str) -> Table:
    """Return the table of NIS per degree of freedom by kind of measurement and epoch.

    NIS is the normalised innovation squared. `column` of the flights holds its sums:
    "nis_last" or "nis_at"; `title` describes them in the title of the table.
    """
    table = Table(title=f"NIS / degrees of freedom, {title}; !: outside {100 * LEVEL:g} % bounds")
    for heading in ("measurement", *(f"{share:.2f}" for share in EPOCHS), "bounds at last epoch",
                    "rejected"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "measurement" else "right")
    by_epoch = [[f[column][k] for f in flights if len(f["nis_at"]) > k]
                for k in range(len(EPOCHS))]  # fmt: skip
    for kind in sorted({kind for at in by_epoch for one in at for kind in one}):
        cells, bounds = [], ""
        for at in by_epoch:
            total = nis_of(at, kind)
            if total.degrees == 0:
                cells.append("")
                continue
            low, high = total.bounds(LEVEL)
            cells.append(f"{total.ratio:.2f}{'' if total.holds(LEVEL) else ' !'}")
            bounds = f"[{low:.2f}, {high:.2f}]"
        refused = sum(f["rejected"].get(kind, 0) for f in flights)
        table.add_row(kind, *cells, bounds, f"{refused}")
    return table


def inconsistencies(flights: Sequence[Row], lower_factor: float) -> list[str]:
    """Return a text for each inconsistency between navigation errors and covariance.

    A text reports more than 2 % of flights that ended lost, an error of more than five standard
    deviations in a flight that did not, or NEES or NIS (normalised squared errors and innovations)
    outside their bounds at an epoch. `lower_factor` multiplies the lower bound of NEES; below 1,
    larger covariances are permitted. The list is empty if navigation is consistent.
    """
    out = []
    lost = sum(f["lost"] for f in flights)
    if lost > MAX_LOST_FRACTION * len(flights):
        out.append(f"{lost} of {len(flights)} flights ended lost")
    for n, f in enumerate(flights):
        # A mean can hide one flight with a large undeclared error.
        off = np.abs(np.array(f["error"])) / np.array(f["sigma"])
        if not (f["lost"] or (off < MAX_ERROR_SIGMA).all()):
            out.append(f"flight {n}: undeclared error of {off.max():.1f} sigma")
    for k, share in enumerate(EPOCHS):
        for part, keep in PARTS.items():
            out += _bound_violation(
                f"NEES of {part} at {share}", nees_of(flights, k, keep), lower_factor, 1.0
            )
        latest = [f["nis_last"][k] for f in flights if len(f["nis_last"]) > k]
        for kind in sorted({kind for at in latest for kind in at}):
            least, most = (
                next((share for end, share in of.items() if kind.endswith(end)), 1.0)
                for of in (MIN_NIS_FACTOR, MAX_NIS_FACTOR)
            )
            out += _bound_violation(f"NIS of {kind} at {share}", nis_of(latest, kind), least, most)
    return out


def _bound_violation(
    name: str, measured: Consistency, lower_factor: float, upper_factor: float
) -> list[str]:
    """Return a text if a normalised squared error is outside its bounds, else no text.

    `name` describes the quantity and `measured` is its sum. `lower_factor` and `upper_factor`
    multiply its lower and upper bound.
    """
    low, high = measured.bounds(LEVEL)
    if lower_factor * low <= measured.ratio <= upper_factor * high:
        return []
    return [
        f"{name}: {measured.ratio:.3f} is outside "
        f"{lower_factor * low:.3f} to {upper_factor * high:.3f}"
    ]
