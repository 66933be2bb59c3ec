"""Figures of flights and comparisons."""

from lunarsim.viz.comparison import draw_comparison
from lunarsim.viz.flight import FlightFigures, draw_flight, plot_flight

__all__ = ["FlightFigures", "draw_comparison", "draw_flight", "plot_flight"]
