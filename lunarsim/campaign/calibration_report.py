"""Report the quality of a refitted calibration as a table and in sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.table import Table

from lunarsim.campaign.calibrate import CalibrationResult
from lunarsim.evaluation.site_calibration import CalibrationComparison, ProbabilityQuality
from lunarsim.typing import Array

_HEADINGS = (
    "Domain", "Calibration", "Sites", "Share of\nall sites", "Observed\nsafe share", "ECE",
    "Brier skill", "Sites with\np > 0.95", "Bias (mean p\nminus observed)",
)  # fmt: skip


def _comparisons_by_domain(
    result: CalibrationResult,
) -> tuple[tuple[str, CalibrationComparison], ...]:
    """Return the comparison of two calibrations on the domain of each, with its name.

    The calibrations are the one supplied with lunarsim ("packaged") and the refit. In each of the
    two domains, they are compared on the same sites.
    """
    return (
        ("packaged", result.left_out.packaged_domain),
        ("refit", result.left_out.refit_domain),
    )


def calibration_table(result: CalibrationResult) -> Table:
    """Build a table of the quality of the supplied and the refitted calibration.

    The supplied ("packaged") calibration comes with lunarsim. Values have 95 % intervals.
    """
    c = result.calibration
    table = Table(
        title=f"{c.scenario}: {c.sites} sites on {result.maps} maps of {c.flights} flights, "
        "leave-one-flight-out"
    )
    for heading in _HEADINGS:
        table.add_column(
            heading, justify="left" if heading in ("Domain", "Calibration") else "right"
        )
    for name, comparison in _comparisons_by_domain(result):
        for calibration, quality in (
            ("packaged", comparison.packaged),
            ("refit", comparison.refit),
        ):
            table.add_row(name, calibration, *_quality_cells(quality))
        table.add_section()
    return table


def _quality_cells(quality: ProbabilityQuality) -> tuple[str, ...]:
    """Return the formatted table cells of one calibration's quality metrics."""
    return (
        str(quality.sites),
        _with_interval(quality.share, "{:.2f}"),
        _with_interval(quality.safe, "{:.3f}"),
        _with_interval(quality.ece),
        _with_interval(quality.skill, "{:+.3f}"),
        str(quality.confident_sites),
        _with_interval(quality.bias, "{:+.4f}"),
    )


def _with_interval(values: Array, form: str = "{:.4f}") -> str:
    """Format value, lower and upper limit (3,) as text; "-" for a value that is NaN.

    `form` is the format string of one number.
    """
    if not np.isfinite(values[0]):
        return "-"
    value, low, high = (form.format(v) for v in values)
    return f"{value} [{low}, {high}]"


def calibration_remarks(result: CalibrationResult) -> Iterator[str]:
    """Yield sentences on the quality and the coefficients of a refitted calibration.

    They state for each domain whether the refit is better than the calibration supplied with
    lunarsim.
    """
    left = result.left_out.refit_domain
    for name, comparison in _comparisons_by_domain(result):
        gain = comparison.gain
        if not np.isfinite(gain).all():
            yield f"In the {name} domain there are no sites to compare the refit on."
            continue
        word = "better" if comparison.better else ("worse" if gain[2] < 0.0 else "no better")
        yield (
            f"In the {name} domain the refit is {word} than the packaged calibration on "
            f"held-out flights: the Brier score is lower by {_with_interval(gain, '{:+.4f}')}."
        )
    if left.refit.skill[0] <= 0.0:
        yield (
            "On held-out flights its probabilities are less informative than the mean safe share: "
            "use more flights."
        )
    if not any(comparison.better for _, comparison in _comparisons_by_domain(result)):
        yield "The refit gives no improvement: use the packaged calibration."
    c = result.calibration
    yield (
        f"Log odds of the refit: {c.inside.intercept:+.3f} {c.inside.slope:+.3f} x packaged in the "
        f"packaged domain, {c.outside.intercept:+.3f} {c.outside.slope:+.3f} x packaged outside"
    )
