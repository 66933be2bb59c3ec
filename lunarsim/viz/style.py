"""What all figures share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.scenario.files import parsed_toml
from lunarsim.simulation.flight import Flight
from lunarsim.whole_files import write_whole

# Okabe and Ito's palette: told apart by colour-blind readers too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
POLICY_COLOURS = {
    "no-divert": "#666666",
    "safest": "#0072B2",
    "nearest-safe": "#009E73",
    "fuel-aware": "#E69F00",
    "truth-oracle": "#CC79A7",
}


def new_figure(width: float, height: float) -> Figure:
    """Return a figure (inches) that draws without a display and without global state."""
    mpl.rcParams.update(
        {
            "font.size": 9, "axes.titlesize": 10, "axes.grid": False, "legend.fontsize": 8,
            "text.usetex": False,  # a matplotlibrc of the working folder could run LaTeX
        }
    )  # fmt: skip
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda part: figure.savefig(part, dpi=130, format="png"))


def literal(text: str) -> str:
    """Return a name so that Matplotlib draws its dollar signs instead of mathematics."""
    return text.replace("$", r"\$")


def end_of(flight: Flight) -> str:
    """Return scenario, policy and end of a flight as a title."""
    name = parsed_toml(flight.scenario).get("name", "unnamed")
    end = "landed safe" if flight.verdict.safe else "failed: " + ", ".join(flight.verdict.failed)
    return literal(f"{name}, {flight.policy}: {end}")


def policy_colour(name: str) -> str:
    """Return the colour of a policy in every figure."""
    return POLICY_COLOURS.get(name, "#56B4E9")


def hillshade(z: NDArray[Any], posting: float) -> NDArray[np.float64]:
    """Return shaded relief in [0, 1] lit from the north-west at 40 deg; NaN stays NaN.

    Shades of ground without gaps are stretched from the darkest to the brightest.
    """
    # Rows run north, where Matplotlib expects them to run south.
    light = LightSource(azdeg=315.0, altdeg=40.0)
    return np.asarray(light.hillshade(np.asarray(z, np.float64), dx=posting, dy=-posting))


def map_axes(axes: Any, title: str) -> None:
    """Label a map."""
    axes.set_title(title)
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.set_aspect("equal")


def show(axes: Any, raster: NDArray[Any], grid: Grid, **options: Any) -> Any:
    """Draw a raster in its place, north up."""
    return axes.imshow(
        raster, origin="lower", extent=grid.extent, interpolation="nearest", **options
    )
