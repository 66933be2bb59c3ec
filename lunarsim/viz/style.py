"""Common style and helpers of all figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lunarsim.atomic_files import atomic_write
from lunarsim.grid import Grid
from lunarsim.scenario.files import parsed_toml
from lunarsim.simulation.flight import Flight
from lunarsim.typing import Array

# Palette of Okabe and Ito for colour-blind readers.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
POLICY_COLOURS = {
    "no-divert": "#666666",
    "safest": "#0072B2",
    "nearest-safe": "#009E73",
    "fuel-aware": "#E69F00",
    "truth-oracle": "#CC79A7",
}


def new_figure(width: float, height: float) -> Figure:
    """Create a figure (size in inches) that needs no display and no global state."""
    mpl.rcParams.update(
        {
            "font.size": 9, "axes.titlesize": 10, "axes.grid": False, "legend.fontsize": 8,
            "text.usetex": False,  # a matplotlibrc in the working folder could run LaTeX
        }
    )  # fmt: skip
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure to a PNG file atomically; create its folder if it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, lambda part: figure.savefig(part, dpi=130, format="png"))


def escape_dollars(text: str) -> str:
    """Escape dollar signs in a name, which Matplotlib would read as mathematics."""
    return text.replace("$", r"\$")


def flight_title(flight: Flight) -> str:
    """Return scenario, policy and outcome of a flight as a title."""
    name = parsed_toml(flight.scenario).get("name", "unnamed")
    end = (
        "safe landing"
        if flight.outcome.safe
        else "failed: " + ", ".join(flight.outcome.failure_causes)
    )
    return escape_dollars(f"{name}, {flight.policy}: {end}")


def policy_colour(name: str) -> str:
    """Return the colour of a policy by its name, the same in every figure.

    Policies that are not in `POLICY_COLOURS` share one colour.
    """
    return POLICY_COLOURS.get(name, "#56B4E9")


def hillshade(z: NDArray[Any], posting: float) -> Array:
    """Return a hillshade (rows, cols) in [0, 1] of an elevation raster.

    The light is from the north-west at 40 deg; `z` is the elevation, `posting` the grid spacing, m;
    NaN stays NaN.

    Without NaN, the shades are stretched over the full range.
    """
    # Rows run north, but Matplotlib expects them to run south.
    light = LightSource(azdeg=315.0, altdeg=40.0)
    return np.asarray(light.hillshade(np.asarray(z, np.float64), dx=posting, dy=-posting))


def map_axes(axes: Any, title: str) -> None:
    """Set title, labels and equal scales of the axes of a map."""
    axes.set_title(title)
    axes.set_xlabel("East (m)")
    axes.set_ylabel("North (m)")
    axes.set_aspect("equal")


def show(axes: Any, raster: NDArray[Any], grid: Grid, **options: Any) -> Any:
    """Draw a raster at the coordinates of its grid, north up; return the image.

    `options` are passed to `imshow` of Matplotlib.
    """
    return axes.imshow(
        raster, origin="lower", extent=grid.extent, interpolation="nearest", **options
    )
