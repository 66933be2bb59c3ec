"""Figures of flights and comparisons."""

from lunarsim.viz.comparison import draw_comparison
from lunarsim.viz.flight import draw_flight, truth_shown

__all__ = ["draw_comparison", "draw_flight", "truth_shown"]
