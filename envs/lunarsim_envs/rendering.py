"""One picture of a flight in progress."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from lunarsim.onboard.policies import Observation
from lunarsim.simulation import Simulation


def draw_frame(simulation: Simulation, observation: Observation) -> NDArray[np.uint8]:
    """Return the descent so far and the hazard map as an image (360, 800, 3), estimated frame."""
    figure = Figure(figsize=(8.0, 3.6), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    profile, plan = figure.subplots(1, 2)
    site = observation.site
    here = observation.estimate.position
    rows = simulation.recorder.trajectory() if simulation.time > 0.0 else None
    if rows is not None:
        away = np.hypot(rows["estimated_x"] - site[0], rows["estimated_y"] - site[1])
        profile.plot(away, rows["estimated_z"] - site[2], color="#0072B2")
    profile.plot(np.hypot(*(here - site)[:2]), here[2] - site[2], "o", color="#D55E00")
    profile.set_xlabel("distance from the site (m)")
    profile.set_ylabel("altitude above the site (m)")
    profile.set_ylim(bottom=-10.0)
    profile.grid(alpha=0.3)
    profile.set_title(f"t = {simulation.time:.1f} s")

    hazard_map = observation.hazard_map
    shown = np.where(hazard_map.observed, hazard_map.p_safe, np.nan)
    plan.set_facecolor("0.8")
    image = plan.imshow(
        shown, origin="lower", extent=hazard_map.grid.extent, vmin=0.0, vmax=1.0, cmap="viridis"
    )
    figure.colorbar(image, ax=plan, label="probability of safety")
    sites = observation.candidates.position
    plan.plot(sites[:, 0], sites[:, 1], "o", mfc="none", mec="white", ms=5)
    radius = simulation.lander.leg_radius
    plan.add_patch(Circle((site[0], site[1]), radius, fill=False, ec="#D55E00", lw=2))
    plan.set_xlabel("east (m)")
    plan.set_ylabel("north (m)")
    title = "hazard map"
    if simulation.verdict is not None:
        safe = simulation.verdict.safe
        title = "landed safe" if safe else "failed: " + ", ".join(simulation.verdict.failed)
    plan.set_title(title)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
