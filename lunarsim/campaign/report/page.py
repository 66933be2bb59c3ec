"""Write the report of a campaign as an HTML page or as Markdown tables."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

import lunarsim
from lunarsim.atomic_files import atomic_write_text
from lunarsim.campaign.analysis import ArmStatistics, column, compute_arm_statistics, differences
from lunarsim.campaign.rare_failures import (
    RareFailureEstimate,
    completion_remark,
    estimate_failure_shares,
    level_table_rows,
    load_chains,
)
from lunarsim.campaign.report.figures import (
    differences_plot,
    landings_plot,
    levels_plot,
    rare_plot,
    reliability_plot,
    sensitivity_plot,
    shares_plot,
    spread_plot,
    touchdown_plot,
    trajectories_plot,
)
from lunarsim.campaign.report.flight_data import recorded_paths, touchdown_axes
from lunarsim.campaign.results import Results, failures, load_results
from lunarsim.campaign.sensitivity import Sensitivity, sensitivities
from lunarsim.errors import InputError, check_output, missing_package
from lunarsim.evaluation.sequences import share_confidence_sequence
from lunarsim.untrusted_files import read_bounded_bytes

# Number of worst flights listed per arm.
_LISTED_PER_ARM = 5
# Maximum number of arms for the sensitivity analysis, and its bootstrap resamples.
_MAX_SENSITIVITY_ARMS, _RESAMPLES = 8, 50
# Maximum number of rows of the table of failure causes.
_MAX_CAUSES = 60
# Underscores within words and brackets without a link need no escape.
_MARKDOWN = re.compile(r"([\\`*<|~]|(?<!\w)_|_(?!\w)|(?<=\])\()")
_LABELS = {
    "propellant_kg": "Propellant (kg)",
    "divert_m": "Divert distance (m)",
    "duration_s": "Flight time (s)",
}


def write_report(folder: str | Path, out: Path) -> Results:
    """Write the report of a campaign, finished or not; return its results.

    Parameters
    ----------
    folder
        Folder of the campaign.
    out
        HTML file, which needs no network, or Markdown file (.md) with the tables only.

    Raises
    ------
    InputError
        If the folder holds no flight, the file name is not usable, or plotly or jinja2 is missing.
    """
    tables_alone = out.suffix.lower() == ".md"
    if not tables_alone and out.suffix.lower() != ".html":
        raise InputError("--out", str(out), "must be a file name that ends in .html or .md")
    check_output("--out", out, out.suffix.lower())
    try:
        import jinja2  # noqa: PLC0415  (an extra)
        from plotly.offline import get_plotlyjs  # noqa: PLC0415
    except ImportError as error:
        raise missing_package("report", str(error.name), "report") from None
    results = load_results(folder)
    if not len(results.table):
        raise InputError("folder", str(folder), "must hold a campaign with at least one flight")
    if results.manifest["columns"].get("safe") != "bool":
        raise InputError("folder", str(folder), "must hold a campaign with the boolean column safe")
    template = _markdown_template(jinja2) if tables_alone else _html_template(jinja2)
    page = template.render(
        **template_variables(results),
        plotly=_in_script(get_plotlyjs()),
        version=lunarsim.__version__,
    )
    atomic_write_text(out, page)
    return results


def _html_template(jinja2: Any) -> Any:
    """Load the Jinja template of the HTML report; `jinja2` is the module."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(_text("page.html.j2"))


def _markdown_template(jinja2: Any) -> Any:
    """Load the Jinja template of the report in Markdown; `jinja2` is the module."""

    def row(cells: Iterable[object]) -> str:
        return f"| {' | '.join(map(_escape_markdown, cells))} |"

    def head(cells: Sequence[object]) -> str:
        return row(cells) + "\n" + row(["---"] * len(cells))

    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters |= {"row": row, "head": head, "literal": _escape_markdown}
    return environment.from_string(_text("page.md.j2"))


def _escape_markdown(text: object) -> str:
    """Return text on one line with Markdown characters escaped."""
    return _MARKDOWN.sub(r"\\\1", " ".join(str(text).split()))


def _text(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def _in_script(text: str) -> Any:
    from markupsafe import Markup  # noqa: PLC0415  (comes with jinja2)

    return Markup(text.replace("</script", "<\\/script"))


def template_variables(results: Results) -> dict[str, Any]:
    """Return the values that the report template shows, by template variable."""
    if results.has_unequal_weights:
        return _rare_template_variables(results)
    statistics = compute_arm_statistics(results)
    # A campaign with a stop rule was monitored, even if it ended before the rule applied.
    watched = "stop" in results.manifest["identity"]
    intervals = {a.name: _interval(a, watched) for a in statistics}
    tables = _difference_tables(results)
    axes, remark = touchdown_axes(results)
    plots = [
        shares_plot(statistics, intervals),
        landings_plot(results, statistics, _terrain_image(results)),
        reliability_plot(results, statistics),
        *(differences_plot(t["differences"], t["id"], t["title"], t["label"]) for t in tables),
        touchdown_plot(results, "touchdown-speed", "Speed at touchdown", axes[0], remark),
        touchdown_plot(results, "touchdown-tilt", "Attitude at touchdown", axes[1], remark),
        trajectories_plot(results, recorded_paths(results)),
        *(spread_plot(results, n, _LABELS[n]) for n in _LABELS if n in results.manifest["columns"]),
    ]
    sensitive, why_not = _sensitivity(results)
    if sensitive:
        plots.append(sensitivity_plot(sensitive))
    return _common_template_variables(results, plots) | {
        "watched": watched,
        "arms": [_row(a, *intervals[a.name]) for a in statistics],
        "difference_tables": {t["id"]: t for t in tables},
        "sensitive": sensitive,
        "no_sensitivity": why_not,
    }


def _rare_template_variables(results: Results) -> dict[str, Any]:
    """Return the template variables of a report on rare failures.

    Statistics that need flights of equal weight are omitted.
    """
    shares = estimate_failure_shares(results)
    chains = load_chains(results) if results.is_subset else None
    rows = [
        {
            "name": s.arm, "rows": s.flights + s.without_outcome, "flown": s.flights,
            "cells": {
                "Failure share": _ranged_share(s),
                "Failures in last level" if chains else "Failures": str(s.failures),
                "Equivalent Monte Carlo flights": (
                    "–" if np.isnan(s.equivalent_flights) else f"{s.equivalent_flights:.3g}"
                ),
            },
        }
        for s in shares
    ]  # fmt: skip
    plots = [rare_plot(shares), levels_plot(chains) if chains else None]
    return _common_template_variables(results, plots) | {
        "levels": level_table_rows(chains) if chains else [],
        "ended": completion_remark(chains) if chains else "",
        "watched": False,
        "arms": rows,
        "difference_tables": {},
        "sensitive": [],
        "no_sensitivity": "",
    }


def _ranged_share(s: RareFailureEstimate) -> str:
    if s.value != s.value:
        return "–"
    rough = " (few failures: approximate)" if s.is_approximate else ""
    return f"{s.value:.3g} [{s.low:.3g}, {s.high:.3g}]{rough}"


def _common_template_variables(
    results: Results, plots: list[dict[str, Any] | None]
) -> dict[str, Any]:
    """Return the template variables that the reports of all campaigns have.

    `plots` are Plotly data, or None for plots that are not available.
    """
    spec = results.folder / "spec.toml"
    drawn = [p for p in plots if p is not None]
    return {
        "m": results.manifest,
        "leaning": results.has_unequal_weights,
        "subset": results.is_subset,
        "levels": [],
        "ended": "",
        "blocks": results.manifest["identity"].get("method") == "saltelli",
        "done": len(results.table),
        "wanted": results.expected_rows,
        "factors": _factors(results),
        "plots": {p["id"]: p for p in drawn},
        "data": drawn,
        "causes": failures(results)[:_MAX_CAUSES],
        "worst": _worst(results),
        "timing": _timing(results),
        "spec": read_bounded_bytes(spec).decode(errors="replace") if spec.is_file() else "",
    }


def _sensitivity(results: Results) -> tuple[list[Sensitivity], str]:
    """Compute the sensitivity of the fraction of safe landings to the random values.

    Return the sensitivity of each arm (variant of the scenario), and the reason if there is none.
    Without random values, the sensitivities and the reason are empty.
    """
    if not results.manifest["identity"].get("dispersions"):
        return [], ""
    if len(results.arms) > _MAX_SENSITIVITY_ARMS:
        return [], f"Not computed for more than {_MAX_SENSITIVITY_ARMS} arms; use the command."
    try:
        found = sensitivities(results, "safe", _RESAMPLES)
    except InputError as error:
        return [], str(error)
    if not any(one.indices for one in found):
        return [], "No indices: " + "; ".join(f"{one.arm}: {one.why_not}" for one in found) + "."
    return found, ""


def _difference_tables(results: Results) -> list[dict[str, Any]]:
    """Return paired differences between arms, with titles and rows of tables.

    An arm is a variant of the scenario. With one arm, or without the column, there is no table.
    """
    if len(results.arms) < 2:
        return []
    wanted = (
        ("differences", "safe", "Paired differences", "Difference of the share of safe landings",
         "Safe share, difference", "p (McNemar)", "+.3f",
         "Paired flights; 95 % intervals by Newcombe, not corrected for multiple comparisons."),
        ("propellant-differences", "propellant_kg", "Paired differences of propellant",
         "Difference of propellant used, mean (kg)", "Propellant, mean difference (kg)",
         "p (paired t)", "+.2f",
         "Paired flights with an outcome, safe or not; 95 % intervals by bootstrap over flights, "
         "not corrected for multiple comparisons."),
    )  # fmt: skip
    tables = []
    for key, metric, title, label, heading, test, form, note in wanted:
        if metric not in results.manifest["columns"]:
            continue
        found = differences(results, metric)
        rows = [
            {"arms": [d.first, d.second],
             "cells": [f"{d.second} − {d.first}", d.pairs,
                       f"{d.value:{form}} [{d.low:{form}}, {d.high:{form}}]", f"{d.p:.3g}",
                       f"{d.corrected:.3g}"]}
            for d in found
        ]  # fmt: skip
        tables.append({
            "id": key, "title": title, "label": label, "differences": found, "rows": rows,
            "head": ["Difference", "Pairs", heading, test, "p (Holm)"], "note": note,
        })  # fmt: skip
    return tables


def _interval(arm: ArmStatistics, has_stop_rule: bool) -> tuple[float, float]:
    """Return the 95 % interval of the fraction of safe landings of an arm.

    An arm is a variant of the scenario. If the campaign has an early-stopping rule
    (`has_stop_rule`), this is a confidence sequence.
    """
    share = arm.shares["safe"]
    return share_confidence_sequence(share.count, share.total) if has_stop_rule else share.interval


def _row(arm: ArmStatistics, low: float, high: float) -> dict[str, Any]:
    """Return the cells of an arm in the report's tables, by column heading.

    An arm is a variant of the scenario. `low` and `high` are the limits of the fraction of safe
    landings.
    """

    def ranged(value: float, low: float, high: float, form: str) -> str:
        if not math.isfinite(value):
            return "–"
        bounds = [format(v, form) if math.isfinite(v) else "?" for v in (low, high)]
        return f"{value:{form}} [{bounds[0]}, {bounds[1]}]"

    cells = {"Safe landings, share": ranged(arm.shares["safe"].value, low, high, ".3f")}
    if "aborted" in arm.shares:
        cells["Aborted"] = str(arm.shares["aborted"].count)
        cells["Navigation lost"] = str(arm.shares["navigation_lost"].count)
    took = {}
    for name, label in _LABELS.items():
        if name in arm.means:
            form = ".1f"
            took[label.replace(" (", ", mean (")] = ranged(*arm.means[name], form)
            took[label.replace(" (", ", 95th percentile (")] = ranged(*arm.quantiles[name][1], form)
    if arm.ellipse is not None:
        long, short = arm.ellipse.half_axes
        cells["Landing ellipse, 95 % (m)"] = f"{long:.1f} × {short:.1f}"
    return {
        "name": arm.name, "rows": arm.rows, "flown": arm.flown, "cells": cells, "took": took
    }  # fmt: skip


def _factors(results: Results) -> dict[str, list[str]]:
    """Return the values of every scenario key in which the arms differ.

    An arm is a variant of the scenario.
    """
    values: dict[str, list[str]] = {}
    for arm in results.manifest["arms"]:
        for key, value in arm["values"].items():
            levels = values.setdefault(key, [])
            if str(value) not in levels:
                levels.append(str(value))
    return {key: levels for key, levels in values.items() if len(levels) > 1}


def _worst(results: Results) -> list[dict[str, Any]]:
    """Return id and cause of the worst flights of each arm.

    An arm is a variant of the scenario. Flights without an outcome come first, then those with high
    speed and tilt at touchdown.
    """
    table = results.table
    speed = np.zeros(len(table))
    for name in ("vertical_speed_m_s", "horizontal_speed_m_s", "tilt_deg"):
        if name in table.column_names:
            speed += np.nan_to_num(column(results, name), nan=1e3, posinf=1e3, neginf=1e3)
    safe = np.nan_to_num(column(results, "safe"), nan=-1.0)  # NaN: no outcome
    bad = ~(safe > 0.5)
    order = np.lexsort((-speed, safe))
    out: list[dict[str, Any]] = []
    for arm in results.arms:
        mine = pc.equal(table["arm"], arm).to_numpy(zero_copy_only=False) & bad
        for row in table.take(pa.array(order[mine[order]][:_LISTED_PER_ARM])).to_pylist():
            why = row["error"] or row.get("failure_causes") or row["outcome"]
            out.append({"id": row["id"], "arm": arm, "why": why})
    return out


def _timing(results: Results) -> dict[str, Any]:
    seconds = np.array(results.timing["seconds"].to_pylist(), dtype=np.float64)
    known = seconds[np.isfinite(seconds)]
    if not len(known):
        return {}
    median, late, most = np.quantile(known, (0.5, 0.95, 1.0))
    ended = np.array(results.timing["finished_unix_s"].to_pylist(), dtype=np.float64)
    return {
        "median": f"{median:.2f}",
        "late": f"{late:.2f}",
        "most": f"{most:.1f}",
        "hours": f"{known.sum() / 3600.0:.2f}",
        "span": f"{(np.nanmax(ended) - np.nanmin(ended)) / 3600.0:.2f}",
        "workers": len({w for w in results.timing["worker"].to_pylist() if w}),
    }


def _terrain_image(results: Results) -> tuple[list[float], list[float], Any] | str | None:
    """Return coordinates and shading of the terrain for the plot of landings.

    The result is the reason if the terrain cannot be built, and None if it differs between flights
    or the folder has no scenario.
    """
    if not (results.folder / "scenario.toml").is_file() or any(
        key.startswith("terrain") for key in results.manifest["inputs"]
    ):
        return None
    from lunarsim.campaign.report.terrain_shading import compute_terrain_shading  # noqa: PLC0415  (loads the simulation)

    try:
        return compute_terrain_shading(
            results.folder / "scenario.toml", int(results.manifest["seed"])
        )
    except InputError as error:
        return str(error)
