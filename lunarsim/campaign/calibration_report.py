"""What a calibration gave, in a table and in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from lunarsim.campaign.calibrate import Calibrated
from lunarsim.evaluation.site_calibration import Figures, Judgement

_HEADINGS = (
    "domain", "p", "sites", "share of\nall sites", "share safe", "ECE", "Brier skill", "p > 0.95",
    "mean p less\nshare safe",
)  # fmt: skip


def _groups(found: Calibrated) -> tuple[tuple[str, Judgement], ...]:
    return (
        ("packaged", found.left_out.packaged_domain),
        ("refit's", found.left_out.refit_domain),
    )


def calibration_table(found: Calibrated) -> Table:
    """Return the figures with 95 % intervals: packaged and refit, on the sites of either domain."""
    c = found.calibration
    table = Table(
        title=f"{c.scenario}: {c.sites} sites on {found.maps} maps of {c.flights} flights; each "
        "flight judged by a refit to the others"
    )
    for heading in _HEADINGS:
        table.add_column(heading, justify="left" if heading in ("domain", "p") else "right")
    for name, judgement in _groups(found):
        for whose, figures in (("packaged", judgement.packaged), ("refit", judgement.refit)):
            table.add_row(name, whose, *_cells(figures))
        table.add_section()
    return table


def _cells(f: Figures) -> tuple[str, ...]:
    return (
        str(f.sites), _ranged(f.share, "{:.2f}"), _ranged(f.safe, "{:.3f}"), _ranged(f.ece),
        _ranged(f.skill, "{:+.3f}"), str(f.sure), _ranged(f.gap, "{:+.4f}"),
    )  # fmt: skip


def _ranged(values: NDArray[np.float64], form: str = "{:.4f}") -> str:
    """Return a figure and its interval; "-" where there is none."""
    if not np.isfinite(values[0]):
        return "-"
    value, low, high = (form.format(v) for v in values)
    return f"{value} [{low}, {high}]"


def verdicts(found: Calibrated) -> Iterator[str]:
    """Yield in words whether the refit is better, and what it is."""
    left = found.left_out.refit_domain
    for name, judgement in _groups(found):
        gain = judgement.gain
        if not np.isfinite(gain).all():
            yield f"In the {name} domain there are no sites to tell whether the refit is better."
            continue
        word = "better" if judgement.better else ("worse" if gain[2] < 0.0 else "no better")
        yield (
            f"In the {name} domain the refit is {word} than the packaged probability, by flights "
            f"left out: Brier score lower by {_ranged(gain, '{:+.4f}')}."
        )
    if left.refit.skill[0] <= 0.0:
        yield (
            "Its probabilities tell less of flights left out than the share of safe sites alone "
            "does: take more flights."
        )
    if not any(judgement.better for _, judgement in _groups(found)):
        yield "Nothing is gained by this file: the packaged calibration alone does as well."
    c = found.calibration
    yield (
        f"log odds of the refit: {c.inside.intercept:+.3f} {c.inside.slope:+.3f} x packaged in the "
        f"packaged domain, {c.outside.intercept:+.3f} {c.outside.slope:+.3f} x packaged outside"
    )
