"""Plots of a campaign report as Plotly data: traces and layout.

An arm is a variant of the scenario in a campaign.

The page sets the colours of text, grid and background for its light or dark theme.
"""

from __future__ import annotations

import html
import math
from typing import Any

import numpy as np
import pyarrow.compute as pc

from lunarsim.campaign.analysis import ArmStatistics, arm_rows, column
from lunarsim.campaign.rare_failures import RareFailureEstimate
from lunarsim.campaign.report.flight_data import MAX_PATHS, LimitedMetric, RecordedPath
from lunarsim.campaign.results import Results
from lunarsim.campaign.sensitivity import Sensitivity
from lunarsim.campaign.subset import SubsetChains
from lunarsim.evaluation.comparisons import Difference, Ellipse
from lunarsim.evaluation.reliability import bin_frequencies, calibration_error, reliability
from lunarsim.evaluation.statistics import Proportion
from lunarsim.typing import Array

# Palette of Okabe and Ito for colour-blind readers; its grey is visible on both themes.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8c8c8c")
# Maximum number of scatter points per arm, which browsers still move smoothly.
_MAX_POINTS = 4000
# Maximum number of points of a line per level.
_MAX_LINE_POINTS = 200
Plot = dict[str, Any]


def colour(index: int) -> str:
    """Return the plot colour of the arm (variant of the scenario) with an index."""
    return COLOURS[index % len(COLOURS)]


def _plot(identity: str, title: str, caption: str, traces: list[Plot], layout: Plot) -> Plot:
    return {
        "id": identity, "title": title, "caption": caption, "data": _escape_html_tags(traces),
        "layout": _escape_html_tags(layout),
    }  # fmt: skip


def _escape_html_tags(value: Any) -> Any:
    """Escape the strings in Plotly data, so that Plotly does not read HTML tags.

    An arm is a variant of the scenario. Names of arms are not escaped, because the page compares
    them and does not display them.
    """
    if isinstance(value, dict):
        return {k: v if k in ("arm", "arms") else _escape_html_tags(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_escape_html_tags(v) for v in value]
    return html.escape(value, quote=False) if isinstance(value, str) else value


def shares_plot(statistics: list[ArmStatistics], intervals: dict[str, tuple[float, float]]) -> Plot:
    """Plot the fraction of safe landings of each arm with its 95 % interval.

    An arm is a variant of the scenario. `intervals` has the lower and upper limit by arm name. Arms
    without a finished flight are omitted.
    """
    traces = []
    for i, arm in enumerate(statistics):
        share = arm.shares["safe"].value
        if not math.isfinite(share):
            continue
        low, high = intervals[arm.name]
        traces.append({
            "type": "scatter", "mode": "markers", "x": [share], "y": [arm.name],
            "error_x": {"type": "data", "symmetric": False, "array": [high - share],
                        "arrayminus": [share - low], "thickness": 2, "width": 6},
            "marker": {"color": colour(i), "size": 11}, "name": arm.name, "arm": arm.name,
            "showlegend": False,
        })  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": "Share of safe landings"}, "range": [-0.02, 1.02]},
        "yaxis": {"autorange": "reversed", "automargin": True},
        "height": 140 + 34 * len(statistics),
    }
    return _plot("shares", "Safe landings", "", traces, layout)


def landings_plot(
    results: Results,
    statistics: list[ArmStatistics],
    terrain: tuple[list[float], list[float], Any] | str | None,
) -> Plot | None:
    """Plot touchdown points and 95 % landing ellipses over the terrain.

    An arm is a variant of the scenario. `statistics` has one entry per arm. `terrain` has east and
    north coordinates, m, and shading, or is the reason why the terrain is not shown. Without
    touchdown points in the results, the plot is None.
    """
    if "touchdown_x_m" not in results.manifest["columns"]:
        return None
    traces: list[Plot] = []
    if isinstance(terrain, tuple):
        x, y, shade = terrain
        traces.append({
            "type": "heatmap", "x": x, "y": y, "z": shade, "colorscale": "Greys", "opacity": 0.55,
            "showscale": False, "hoverinfo": "skip",
        })  # fmt: skip
    safe = column(results, "safe")
    xs, ys = (column(results, name) for name in ("touchdown_x_m", "touchdown_y_m"))
    names = np.array(results.table["id"].to_pylist())
    rows_of = arm_rows(results)
    for i, arm in enumerate(statistics):
        for good, symbol in ((True, "circle"), (False, "x")):
            rows = np.flatnonzero(rows_of[arm.name] & np.isfinite(xs) & ((safe > 0.5) == good))
            rows = rows[:: max(1, -(-len(rows) // _MAX_POINTS))]
            traces.append({
                "type": "scatter", "mode": "markers", "x": _numbers(xs[rows]),
                "y": _numbers(ys[rows]), "text": names[rows].tolist(),
                "name": f"{arm.name}, {'safe' if good else 'not safe'}", "arm": arm.name,
                "marker": {"color": colour(i), "symbol": symbol, "size": 7 if good else 9,
                           "line": {"width": 1, "color": "white"}},
            })  # fmt: skip
        if arm.ellipse is not None:
            east, north = _outline(arm.ellipse)
            traces.append({
                "type": "scatter", "mode": "lines", "x": east, "y": north, "arm": arm.name,
                "name": f"{arm.name}, 95 % ellipse", "line": {"color": colour(i)},
                "showlegend": False, "hoverinfo": "skip",
            })  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": "East (m)"}},
        "yaxis": {"title": {"text": "North (m)"}, "scaleanchor": "x"},
        "height": 620,
    }
    caption = "Each point is a flight; crosses are landings that were not safe. "
    if isinstance(terrain, tuple):
        caption += "Shading: terrain without rocks, which all flights share."
    elif terrain is not None:
        caption += f"The terrain is not shown: {terrain}"
    return _plot("landings", "Touchdown points", caption, traces, layout)


def _outline(ellipse: Ellipse) -> tuple[list[float], list[float]]:
    t = np.linspace(0.0, 2.0 * np.pi, 73)
    long, short = ellipse.half_axes[0] * np.cos(t), ellipse.half_axes[1] * np.sin(t)
    sine, cosine = np.sin(ellipse.azimuth), np.cos(ellipse.azimuth)
    return (
        _numbers(ellipse.centre[0] + long * sine + short * cosine),
        _numbers(ellipse.centre[1] + long * cosine - short * sine),
    )


def reliability_plot(results: Results, statistics: list[ArmStatistics]) -> Plot | None:
    """Plot the observed fraction of truly safe sites against predicted probability.

    Without a column of predicted probabilities, the plot is None.
    """
    if "p_safe" not in results.manifest["columns"]:
        return None
    predicted = column(results, "p_safe")
    true = column(results, "touchdown_exactly_safe")
    known = (
        np.isfinite(predicted) & np.isfinite(true) & np.isfinite(column(results, "touchdown_x_m"))
    )
    traces: list[Plot] = [
        {"type": "scatter", "mode": "lines", "x": [0, 1], "y": [0, 1], "name": "ideal",
         "line": {"dash": "dot", "color": "#8c8c8c"}}
    ]  # fmt: skip
    rows_of = arm_rows(results)
    words = []
    for i, arm in enumerate(statistics):
        rows = rows_of[arm.name] & known
        table = reliability(predicted[rows], true[rows])
        p, share = bin_frequencies(table)
        filled = table[:, 0] > 0
        intervals = [Proportion(int(h), int(n)).interval for n, _, h in table[filled]]
        low, high = np.array(intervals).reshape(-1, 2).T
        traces.append({
            "type": "scatter", "mode": "markers+lines", "x": _numbers(p[filled]),
            "y": _numbers(share[filled]), "name": arm.name, "arm": arm.name,
            "text": [f"{int(n)} landings" for n in table[filled, 0]],
            "error_y": {"type": "data", "symmetric": False,
                        "array": _numbers(high - share[filled]),
                        "arrayminus": _numbers(share[filled] - low), "thickness": 1},
            "marker": {"color": colour(i), "size": 8},
            "line": {"color": colour(i), "width": 1},
        })  # fmt: skip
        words.append(f"{arm.name} {calibration_error(table):.3f}")
    layout = {
        "xaxis": {"title": {"text": "Predicted p_safe of the last site"}, "range": [-0.03, 1.03]},
        "yaxis": {"title": {"text": "Observed share on exactly safe terrain"},
                  "range": [-0.03, 1.03]},
        "height": 480,
    }  # fmt: skip
    text = (
        "The policy chose these sites: a policy that prefers a high p_safe also selects its "
        "errors. If the lander misses its site, the actual touchdown point counts. Expected "
        "calibration error: " + ", ".join(words) + "."
    )
    return _plot("reliability", "Reliability of p_safe", text, traces, layout)


def differences_plot(
    differences: list[Difference], plot_id: str = "differences",
    title: str = "Paired differences", label: str = "Difference of the share of safe landings",
) -> Plot:  # fmt: skip
    """Plot the differences of a metric between pairs of arms.

    An arm is a variant of the scenario. `label` is the difference with its unit.
    """
    names = [f"{d.second} − {d.first}" for d in differences]
    traces = [
        {"type": "scatter", "mode": "markers", "x": [d.value], "y": [name],
         "arms": [d.first, d.second], "showlegend": False,
         "error_x": {"type": "data", "symmetric": False,
                     "array": [float(np.nan_to_num(d.high - d.value))],
                     "arrayminus": [float(np.nan_to_num(d.value - d.low))],
                     "thickness": 2, "width": 5},
         "marker": {"size": 10, "color": "#0072B2" if d.corrected < 0.05 else "#8c8c8c"}}
        for d, name in zip(differences, names, strict=True) if d.pairs
    ]  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": label}, "zeroline": True,
                  "zerolinewidth": 2},
        "yaxis": {"autorange": "reversed", "automargin": True},
        "height": 140 + 30 * len(differences),
    }  # fmt: skip
    caption = (
        "Second arm minus first, paired by flight, with 95 % interval. Blue: significant after "
        "Holm's correction; grey: not significant."
    )
    return _plot(plot_id, title, caption, traces, layout)


def touchdown_plot(
    results: Results, plot_id: str, title: str, axes: tuple[LimitedMetric, LimitedMetric],
    limits_remark: str,
) -> Plot | None:  # fmt: skip
    """Plot two metrics of each touchdown with their limits, for each arm.

    An arm is a variant of the scenario. Without these columns or without a touchdown, the plot is
    None. `limits_remark` states why limits are not drawn, or is empty.
    """
    if not all(axis.column in results.manifest["columns"] for axis in axes):
        return None
    x, y = (column(results, axis.column) for axis in axes)
    safe = column(results, "safe")
    names = np.array(results.table["id"].to_pylist())
    traces: list[Plot] = []
    for i, (arm, mine) in enumerate(arm_rows(results).items()):
        for good, symbol in ((True, "circle"), (False, "x")):
            rows = np.flatnonzero(mine & np.isfinite(x) & np.isfinite(y) & ((safe > 0.5) == good))
            rows = rows[:: max(1, -(-len(rows) // _MAX_POINTS))]
            if len(rows):
                traces.append({
                    "type": "scatter", "mode": "markers", "x": _numbers(x[rows]),
                    "y": _numbers(y[rows]), "text": names[rows].tolist(), "arm": arm,
                    "name": f"{arm}, {'safe' if good else 'not safe'}",
                    "marker": {"color": colour(i), "symbol": symbol, "size": 7 if good else 9},
                })  # fmt: skip
    if not traces:
        return None
    shapes = [
        {"type": "line", f"{a}0": axis.limit, f"{a}1": axis.limit, f"{b}ref": "paper", f"{b}0": 0,
         f"{b}1": 1, "line": {"color": COLOURS[-1], "dash": "dash", "width": 2}}
        for axis, a, b in zip(axes, "xy", "yx", strict=True) if axis.limit is not None
    ]  # fmt: skip
    layout: Plot = {"height": 480, "shapes": shapes}
    for name, axis, values in zip(("xaxis", "yaxis"), axes, (x, y), strict=True):
        top = 1.1 * max(float(np.nanmax(values)), axis.limit or 0.0)
        layout[name] = {"title": {"text": axis.label}, "range": [0.0, top]}
    caption = "Each point is a touchdown; crosses are landings that were not safe. "
    caption += limits_remark or "Dashed: limits of the lander."
    return _plot(plot_id, title, caption, traces, layout)


def trajectories_plot(results: Results, paths: list[RecordedPath]) -> Plot | None:
    """Plot the recorded trajectories of each arm as a bundle, relative to their ends.

    An arm is a variant of the scenario. Without records the plot is None.
    """
    traces: list[Plot] = []
    for i, arm in enumerate(results.arms):
        for good in (True, False):
            mine = [path for path in paths if path.arm == arm and path.is_safe == good]
            # None separates the lines of one trace.
            x: list[float | None] = [v for p in mine for v in (*_numbers(p.distance), None)]
            y: list[float | None] = [v for p in mine for v in (*_numbers(p.height), None)]
            if mine:
                traces.append({
                    "type": "scatter", "mode": "lines", "x": x, "y": y, "arm": arm,
                    "name": f"{arm}, {'safe' if good else 'not safe'} ({len(mine)})",
                    "opacity": 0.6, "hoverinfo": "name",
                    "line": {"color": colour(i), "width": 1, "dash": "solid" if good else "dash"},
                })  # fmt: skip
    if not traces:
        return None
    layout = {
        "xaxis": {"title": {"text": "Horizontal distance to the end of the flight (m)"},
                  "autorange": "reversed"},
        "yaxis": {"title": {"text": "Height above the end of the flight (m)"}},
        "height": 480,
    }  # fmt: skip
    caption = (
        "True trajectories of recorded flights, at most "
        f"{MAX_PATHS} per arm; dashed lines are landings that were not safe."
    )
    return _plot("trajectories", "Trajectories", caption, traces, layout)


def rare_plot(estimates: list[RareFailureEstimate]) -> Plot:
    """Plot the estimated probability of failure of each arm with its interval.

    An arm is a variant of the scenario in a campaign; arms without failures are omitted.
    """
    traces = [
        {"type": "scatter", "mode": "markers", "x": [s.value], "y": [s.arm], "arm": s.arm,
         "error_x": {"type": "data", "symmetric": False, "array": [s.high - s.value],
                     "arrayminus": [s.value - s.low], "thickness": 2, "width": 5},
         "marker": {"size": 10, "color": colour(i)}, "name": s.arm, "showlegend": False}
        for i, s in enumerate(estimates) if s.value > 0.0
    ]  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": "Failure share"}, "type": "log", "exponentformat": "power"},
        "yaxis": {"autorange": "reversed", "automargin": True},
        "height": 150 + 34 * len(traces),
    }
    caption = "Arms without a failed flight are listed only in the table."
    return _plot("shares", "Failure share", caption, traces, layout)


def levels_plot(chains: SubsetChains) -> Plot | None:
    """Plot the distribution of the failure metric in the levels of subset simulation.

    Without a finished level, the plot is None.
    """
    traces: list[Plot] = []
    reached = 1.0
    for number, level in enumerate(chains.levels):
        margins = np.sort(level.margins, axis=None)
        shares = reached * np.arange(1, margins.size + 1) / margins.size
        known = np.isfinite(margins) & (margins >= level.threshold)
        at = np.flatnonzero(known)[:: max(1, int(known.sum()) // _MAX_LINE_POINTS)]
        reached *= level.share
        traces.append({
            "type": "scatter", "mode": "lines", "name": f"level {number}",
            "x": [chains.value_of(float(m)) for m in margins[at]],
            "y": [float(v) for v in shares[at]], "line": {"color": colour(number), "width": 3},
        })  # fmt: skip
    if not traces:
        return None
    layout = {
        "xaxis": {"title": {"text": chains.metric}},
        "yaxis": {"title": {"text": "Share of flights at least this close to failure"},
                  "type": "log", "exponentformat": "power"},
        "height": 420,
    }  # fmt: skip
    caption = "The flights of a level closest to failure are the seeds of the next level."
    return _plot("levels", "Distance from failure", caption, traces, layout)


def sensitivity_plot(sensitivities: list[Sensitivity]) -> Plot:
    """Plot the sensitivity of safe landings to the random values, with intervals.

    An arm is a variant of the scenario. `sensitivities` has one entry per arm; hollow symbols are
    total indices.
    """
    traces = []
    names: tuple[str, ...] = ()
    for i, one in enumerate(sensitivities):
        names = one.names
        for label, values in one.indices.items():
            v, low, high = np.array(values).T
            traces.append({
                "type": "scatter", "mode": "markers", "arm": one.arm, "name": f"{one.arm}, {label}",
                "x": _numbers(v), "y": list(one.names),
                "error_x": {"type": "data", "symmetric": False, "array": _numbers(high - v),
                            "arrayminus": _numbers(v - low), "thickness": 1, "width": 4},
                "marker": {"color": colour(i), "size": 9,
                           "symbol": "circle-open" if label == "total" else "circle"},
            })  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": "Sensitivity index of the safe share"}, "zeroline": True},
        "yaxis": {"autorange": "reversed", "automargin": True},
        "scattermode": "group",
        "height": 170 + (30 + 12 * len(traces)) * len(names),
    }
    if sensitivities and sensitivities[0].method == "sobol":
        caption = (
            "Sobol indices: the share of the variance explained by a key alone (first order, full) "
            "and with all its interactions (total, hollow). World and noise: rocks, sensor noise, "
            "navigation errors."
        )
    else:
        chance = [
            f"{one.arm} {one.chance:.3f}" for one in sensitivities if one.chance == one.chance
        ]
        caption = (
            "PAWN: change of the share when a key is limited to a tenth of its range, median of "
            "ten tenths. Value that chance alone can give: " + ", ".join(chance) + "."
        )
    missing = [f"{one.arm}: {one.why_not}" for one in sensitivities if one.why_not]
    more = " No indices: " + "; ".join(missing) + "." if missing else ""
    return _plot("sensitivity", "Sensitivity to the dispersions", caption + more, traces, layout)


def spread_plot(results: Results, metric: str, label: str) -> Plot:
    """Plot quartiles and 5th and 95th percentiles of a metric for each arm.

    An arm is a variant of the scenario. `metric` is the result column, and `label` its name with
    unit.
    """
    traces = []
    flown = pc.equal(results.table["outcome"], "flown").to_numpy(zero_copy_only=False)
    for i, (arm, rows) in enumerate(arm_rows(results).items()):
        values = column(results, metric, rows & flown)
        values = values[np.isfinite(values)]
        if not len(values):
            continue
        low, q1, middle, q3, high = (
            [float(v)] for v in np.quantile(values, (0.05, 0.25, 0.5, 0.75, 0.95))
        )
        traces.append({
            "type": "box", "orientation": "h", "y": [arm], "q1": q1, "median": middle, "q3": q3,
            "lowerfence": low, "upperfence": high, "marker": {"color": colour(i)}, "arm": arm,
            "name": arm, "showlegend": False,
        })  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": label}},
        "yaxis": {"autorange": "reversed", "automargin": True},
        "height": 140 + 34 * len(traces),
    }
    return _plot(metric, label, "Box: quartiles; whiskers: 5th and 95th percentile", traces, layout)


def _numbers(values: Array) -> list[float]:
    return [round(float(v), 4) for v in values]
