"""Draw true and estimated heights of the past failures, with and without the fault.

python scenarios/flown_failures/figure.py docs/images/flown_failures.png
"""

from __future__ import annotations

import sys
from pathlib import Path

from flown_failures import MISSIONS, scenario_of

from lunarsim import Simulation
from lunarsim.viz.style import COLOURS, new_figure, save

# Seed of the flights, as the first of the study.
_SEED = 1


def main() -> None:
    """Fly each mission once with and once without its fault; draw height and error over time."""
    figure = new_figure(11.0, 5.0)
    axes = figure.subplots(2, len(MISSIONS), sharex="col", height_ratios=(2, 1))
    for (heights, errors), mission in zip(axes.T, MISSIONS, strict=True):
        for arm, colour in (("no fault", COLOURS[0]), ("failure", COLOURS[1])):
            simulation = Simulation(scenario_of(mission, arm), _SEED, "no-divert")
            flight = simulation.run()
            path = flight.trajectory
            # The elevation in `flight.target` is the one that the onboard computer knows.
            true = path["position_z"] - simulation.world.terrain.elevation(flight.target[None, :2])
            known = path["estimated_z"] - path["site_z"]
            heights.plot(path["time"], true, color=colour, label=f"{arm}, true")
            heights.plot(path["time"], known, color=colour, linestyle=":", label=f"{arm}, estimate")
            errors.plot(path["time"], known - true, color=colour)
            for event in flight.events:
                if event["name"] == "fault-started":
                    errors.axvline(event["time"], color="#8c8c8c", linewidth=0.8, linestyle="--")
        heights.set_title(mission)
        errors.set_xlabel("Time (s)")
        for axis in (heights, errors):
            axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("Height above the site (m)")
    axes[1, 0].set_ylabel("Height error (m)")
    axes[0, -1].legend(loc="upper right")
    save(figure, Path(sys.argv[1]))


if __name__ == "__main__":
    main()
