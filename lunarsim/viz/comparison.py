"""Draw the figure of a comparison of policies."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from lunarsim.evaluation.statistics import mean_interval, summarise_policies
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.typing import Array
from lunarsim.viz.style import COLOURS, escape_dollars, new_figure, policy_colour, save

Rows = list[dict[str, Any]]

_COLUMNS = 6
# Distinguish causes in greyscale prints too.
_HATCHES = ("", "///", "...", "xxx", "\\\\\\", "ooo", "+++", "---")


def draw_comparison(rows: Rows, scenario: Scenario, path: Path) -> None:
    """Draw a comparison of policies: safety, failures, metrics and map quality.

    Parameters
    ----------
    rows
        One row per flight and policy, with the columns of `lunarsim.evaluation.flight_metrics`.
    scenario
        Scenario of the flights, with the limits of the lander.
    path
        PNG file to write.
    """
    names = list(dict.fromkeys(row["policy"] for row in rows))
    lander = scenario.true_lander()
    figure = new_figure(18, 7.6)
    axes = figure.subplots(2, _COLUMNS).ravel()
    _draw_safety(axes[0], rows, names)
    _draw_causes(axes[1], rows, names)
    boxes = (
        ("propellant_kg", f"Propellant used (kg; {lander.propellant_mass:g} loaded)", None),
        ("divert_m", "Divert distance (m)", None),
        ("vertical_speed_m_s", "Vertical touchdown speed (m/s)", lander.vertical_speed_limit),
        ("horizontal_speed_m_s", "Lateral touchdown speed (m/s)", lander.horizontal_speed_limit),
        ("tilt_deg", "Tilt at touchdown (deg)", float(np.rad2deg(lander.tilt_limit))),
    )
    for ax, (column, label, limit) in zip(axes[2:7], boxes, strict=True):
        _draw_boxes(ax, rows, names, column, label)
        if limit is not None:
            ax.axvline(limit, color="black", lw=1.2, ls="--", label="limit")
            ax.legend(loc="best")
    _draw_differences(axes[7], rows, names)
    limits = {column: (label.partition(" (")[0], limit) for column, label, limit in boxes if limit}
    _draw_limit_differences(axes[8], rows, names, limits)
    _draw_maps(axes[9], rows, names)
    _draw_propellant_differences(axes[10], rows, names)
    _draw_touchdown_speeds(axes[11], rows, names, lander)
    shown = [escape_dollars(name) for name in names]
    for i, ax in enumerate(axes[:-1]):
        ax.set_yticks(range(len(names)), shown if i % _COLUMNS == 0 else [""] * len(names))
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.grid(axis="x", alpha=0.3)
    flights = sum(row["policy"] == names[0] for row in rows)
    figure.suptitle(
        f"{escape_dollars(scenario.name)}: {flights} flights per policy over the same worlds"
    )
    save(figure, path)


def _draw_safety(ax: Any, rows: Rows, names: list[str]) -> None:
    summary = summarise_policies(rows)
    place = np.arange(len(names))
    share = np.array([summary[n]["safe"].value for n in names])
    low = share - [summary[n]["safe"].interval[0] for n in names]
    high = np.array([summary[n]["safe"].interval[1] for n in names]) - share
    ax.barh(place, share, color=[policy_colour(name) for name in names])
    spread = np.maximum(np.stack((low, high)), 0.0)
    ax.errorbar(share, place, xerr=spread, fmt="none", ecolor="black", capsize=3)
    ax.set_xlim(0.0, 1.0)
    ax.set_xlabel("Safe landings, share (95 % Wilson interval)")


def _draw_causes(ax: Any, rows: Rows, names: list[str]) -> None:
    """Draw the number of failed flights of each policy by their first failure cause."""
    first = [
        (row["policy"], row["failure_causes"].split(",")[0]) for row in rows if not row["safe"]
    ]
    causes = [cause for cause, _ in Counter(cause for _, cause in first).most_common()]
    left = np.zeros(len(names))
    for i, cause in enumerate(causes):
        counts = np.array([first.count((name, cause)) for name in names], dtype=np.float64)
        ax.barh(
            range(len(names)), counts, left=left, color=COLOURS[i % len(COLOURS)], ec="black",
            hatch=_HATCHES[i % len(_HATCHES)], lw=0.5, label=cause,
        )  # fmt: skip
        left += counts
    ax.set_xlim(0.0, max(1.0, 1.3 * left.max()))
    ax.set_xlabel("Failed flights, by first cause")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    if causes:
        ax.legend(loc="best")
    else:
        ax.text(0.5, 0.5, "no failures", transform=ax.transAxes, ha="center")


def _draw_boxes(ax: Any, rows: Rows, names: list[str], column: str, label: str) -> None:
    data = []
    for name in names:
        values = np.array([r[column] for r in rows if r["policy"] == name], dtype=np.float64)
        data.append(values[np.isfinite(values)])
    drawn = ax.boxplot(
        data, positions=range(len(names)), orientation="horizontal", widths=0.6, patch_artist=True
    )
    for box, name in zip(drawn["boxes"], names, strict=True):
        box.set_facecolor(policy_colour(name))
        box.set_alpha(0.75)
    for line in drawn["medians"]:
        line.set_color("black")
    ax.set_xlabel(label)


def _draw_differences(ax: Any, rows: Rows, names: list[str]) -> None:
    """Draw how many flights are safe under one policy but not under the first policy.

    Flights that are safe only under the first policy are drawn to the left.
    """
    safe = {(row["policy"], row["flight"]): row["safe"] for row in rows}
    flights = sorted({row["flight"] for row in rows})
    for place, name in enumerate(names):
        pairs = [
            (safe[names[0], f], safe[name, f])
            for f in flights
            if (names[0], f) in safe and (name, f) in safe
        ]
        better = sum(not a and b for a, b in pairs)
        worse = sum(a and not b for a, b in pairs)
        ax.barh(
            place, better, height=0.5, color=COLOURS[0],
            label="safe only under this policy" if not place else None,
        )  # fmt: skip
        ax.barh(place, -worse, height=0.5, color=COLOURS[1], hatch="///", ec="black", lw=0.5,
                label=None if place else f"safe only under {escape_dollars(names[0])}")  # fmt: skip
        if place:
            # Above the bar, where the bar of the first policy is far away.
            ax.text(0.0, place - 0.28, f" {better} better, {worse} worse", va="bottom", fontsize=7)
    ax.axvline(0.0, color="black", lw=0.8)
    low, high = ax.get_xlim()
    ax.set_xlim(min(low, -1.0), max(high, 1.0))
    ax.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    ax.set_xlabel(f"Flights with another outcome\nthan under {escape_dollars(names[0])}")
    ax.legend(loc="best")


def paired_differences(rows: Rows, first: str, other: str, column: str) -> Array:
    """Return the difference of a column between two policies, for each flight (n,).

    It is the value under policy `other` minus the value under policy `first`; flights without both
    values are omitted.
    """
    values = {(row["policy"], row["flight"]): row[column] for row in rows}
    flights = sorted({flight for policy, flight in values if policy == other})
    pairs = [(values.get((first, f), np.nan), values[other, f]) for f in flights]
    shift = np.array([b - a for a, b in pairs], dtype=np.float64)
    return shift[np.isfinite(shift)]


def _draw_limit_differences(
    ax: Any, rows: Rows, names: list[str], limits: dict[str, tuple[str, float]]
) -> None:
    """Draw differences from the first policy by flight, relative to lander limits.

    `limits` has the label and the limit of each column.

    Marker: mean; thick bar: its 95 % interval (Student's t); thin bar: range of all flights.
    """
    markers = ("o", "s", "^")
    for n, (column, (label, limit)) in enumerate(limits.items()):
        colour, offset = COLOURS[n], 0.22 * (n - 1)
        ax.plot([], [], markers[n], color=colour, mec="black", mew=0.6, label=label)
        for place, name in enumerate(names[1:], 1):
            shift = paired_differences(rows, names[0], name, column) / limit
            if not shift.size:
                continue
            at, found = place + offset, mean_interval(shift)
            low, high = found.mean - found.half, found.mean + found.half
            ax.plot([shift.min(), shift.max()], [at, at], color=colour, lw=0.8)
            ax.plot([low, high], [at, at], color=colour, lw=3.0)  # no bar for a single flight (NaN)
            ax.plot(found.mean, at, markers[n], color=colour, mec="black", mew=0.6)
    ax.axvline(0.0, color="black", lw=0.8)
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.set_xlabel(f"Paired difference from {escape_dollars(names[0])},\nrelative to the limit")
    ax.legend(loc="upper left")


def _draw_propellant_differences(ax: Any, rows: Rows, names: list[str]) -> None:
    """Draw the propellant of each policy minus that of the first, by flight.

    Marker: mean; thick bar: its 95 % interval (Student's t); thin bar: range of all flights.
    """
    for place, name in enumerate(names[1:], 1):
        shift = paired_differences(rows, names[0], name, "propellant_kg")
        if shift.size:
            found, colour = mean_interval(shift), policy_colour(name)
            ax.plot([shift.min(), shift.max()], [place, place], color=colour, lw=0.8)
            ends = [found.mean - found.half, found.mean + found.half]
            ax.plot(ends, [place, place], color=colour, lw=3.0)
            ax.plot(found.mean, place, "o", color=colour, mec="black", mew=0.6)
    ax.axvline(0.0, color="black", lw=0.8)
    ax.set_xlabel(f"Propellant, paired difference from\n{escape_dollars(names[0])} (kg)")


def _draw_touchdown_speeds(ax: Any, rows: Rows, names: list[str], lander: Lander) -> None:
    """Draw the speeds of each touchdown; crosses are landings that were not safe."""
    for name in names:
        for safe, marker in ((True, "o"), (False, "x")):
            mine = [r for r in rows if r["policy"] == name and r["safe"] == safe]
            x, y = (
                np.array([r[f"{axis}_speed_m_s"] for r in mine], dtype=np.float64)
                for axis in ("horizontal", "vertical")
            )
            ax.plot(x, y, marker, color=policy_colour(name), ms=4)
    ax.axvline(lander.horizontal_speed_limit, color="black", lw=1.2, ls="--", label="limits")
    ax.axhline(lander.vertical_speed_limit, color="black", lw=1.2, ls="--")
    ax.set_xlim(left=0.0)
    ax.set_ylim(0.0, 1.2 * max(ax.get_ylim()[1], lander.vertical_speed_limit))
    ax.set_xlabel("Lateral speed at contact (m/s)\ncircles: safe, crosses: not safe")
    ax.set_ylabel("Vertical speed at contact (m/s)")
    ax.grid(alpha=0.3)
    ax.legend(loc="best")


def _draw_maps(ax: Any, rows: Rows, names: list[str]) -> None:
    summary = summarise_policies(rows)
    for place, name in enumerate(names):
        figures = summary[name]["precision"], summary[name]["recall"]
        ax.plot(figures[0], place - 0.12, "o", color=COLOURS[0], mec="black", mew=0.6,
                label="precision" if not place else None, clip_on=False)  # fmt: skip
        ax.plot(figures[1], place + 0.12, "D", color=COLOURS[4], mec="black", mew=0.6,
                label="recall" if not place else None, clip_on=False)  # fmt: skip
        if np.isnan(figures[0]):
            ax.text(0.02, place - 0.12, "no cell classified safe", va="center", size=7)
    ax.set_xlim(0.0, 1.03)
    ax.set_xlabel("Map precision and recall, cells with p > 0.5")
    ax.legend(loc="best")
